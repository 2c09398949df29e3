"""Newton's method for one three-phase power flow, used if the sweep does not settle.

Near the largest load that a feeder can carry, the sweep converges slowly or not at all. Newton's method solves the same
equations for the voltages V of all nodes and the currents I of their branches,

    V_m - A V_n + B I_m = 0          I_m - (what legs, capacitors and susceptances draw at V_m) - sum of A^T I = 0

from the voltages without load. On feeders that are not radial the equations are those of ``nodal``. It returns the
solution of high voltage, to which a growing load leads. The determinant of the derivative changes its sign where that
solution and one of low voltage meet, so its sign must be that without load. If the step to the whole load fails, the
load grows in smaller steps.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA
from dcgrid_env.powerflow.unbalanced.nodal import coupler_ratios, nodal_matrix
from dcgrid_env.powerflow.unbalanced.plan import REGULATOR, plan_of

MOST = 40
"""Most steps of Newton's method for one load."""
SHRINKS = 0.9
"""Ratio of a change of the voltages to the one before beyond which a load is given up. It is 1/2 on the way to the
largest load, and less below it."""
CLOSE_PU = 1e-8
"""Change of a voltage at which the method ends. It converges quadratically, so what is left is rounding."""
LEAST_SHARE = 1.0 / 16.0
"""Least part of the load that is added at a time."""
TINY = 1e-30
OF_P, OF_Q = (2, 11, 15), (5, 13, 16)
"""Rows of the law with the first share, the line below vmin and the power, of p and of q."""

FloatArray = NDArray[np.float64]


class Places(NamedTuple):
    """Rows and columns of the equations' entries; ``n_node`` is ground, which has none."""

    bus: np.ndarray
    """Bus of each entry of the branches' matrices."""
    entry: np.ndarray
    """Which of the nine entries of its bus it is."""
    row: np.ndarray
    column: np.ndarray
    above: np.ndarray
    """Node that feeds the column's."""


class Equations:
    """The equations of one power flow and their derivative, sparse, real parts first: V, I, then their imaginary parts.

    With nodal equations I are the currents of the couplers.

    Parameters
    ----------
    feeder
        The feeder.
    p_kw, q_kvar, source_pu, ratio, state
        One power flow as ``solve_batch`` takes it, without leading dimensions.
    """

    def __init__(
        self, feeder: ThreePhaseFeeder, p_kw: Array, q_kvar: Array, source_pu: Array, ratio: Array, state: Array
    ):
        plan, n = plan_of(feeder), feeder.n_node
        self.n, self._law, self._is_z = n, plan.leg_law.T, plan.leg_is_z
        self._has_exponents = plan.leg_has_exponents
        self.legs_at, self.legs_sign = (n, -1.0) if feeder.is_radial else (0, 1.0)
        """The first equation in which legs draw, and the sign with which."""
        load, device = p_kw[:-n] - 1j * q_kvar[:-n], p_kw[-n:] - 1j * q_kvar[-n:]
        self._load = load[plan.leg_order.astype(np.intp)] * plan.leg_law[:, 0]
        self._device = device / PHASE_BASE_KVA
        nodes = np.arange(n)
        self.ends = np.concatenate((plan.leg_ends.astype(np.intp), np.stack((nodes, np.full(n, n)), axis=1)))
        ideal = source_pu * (plan.source[:, 0] + 1j * plan.source[:, 1])
        if feeder.is_radial:
            self.half, linear = 2 * n, _linear(feeder, ratio, state)
        else:
            matrix: Any = nodal_matrix(feeder, coupler_ratios(feeder, ratio)).tocoo()
            self.half, ideal = matrix.shape[0], feeder.nodal.source_y @ ideal
            entries = ((matrix.data, matrix.row, matrix.col), *_shunts(feeder, state))
            linear = tuple(np.concatenate(one) for one in zip(*entries, strict=True))
        self._linear = self._real(*linear)
        right = np.zeros(self.half, np.complex128)
        right[:3] = ideal
        self._right = np.concatenate((right.real, right.imag))
        i, j = self.ends.T
        self._rows, self._columns = np.concatenate((i, i, j, j)), np.concatenate((i, j, i, j))

    def without_load(self) -> tuple[FloatArray, SuperLU]:
        """Voltages and currents without loads and devices, and the factors of the derivative there."""
        factors = splu(self._matrix())
        return factors.solve(self._right), factors

    def evaluate(self, x: FloatArray, share: float) -> tuple[FloatArray, csc_matrix]:
        """By how much the equations miss at ``x`` under a share of all loads and devices, and their derivative."""
        n = self.n
        v = np.append(self.voltages(x), 0.0)
        across = v[self.ends[:, 0]] - v[self.ends[:, 1]]
        current, slopes = self._drawn(across, share)
        drawn = np.zeros(n + 1, np.complex128)
        np.add.at(drawn, self.ends[:, 0], current)
        np.subtract.at(drawn, self.ends[:, 1], current)
        missing = self._matrix() @ x - self._right
        for first, part in ((self.legs_at, drawn.real), (self.legs_at + self.half, drawn.imag)):
            missing[first : first + n] += self.legs_sign * part[:n]
        return missing, self._matrix(slopes)

    def voltages(self, x: FloatArray) -> Any:
        """Complex voltages of the nodes in a vector of all unknowns."""
        return x[: self.n] + 1j * x[self.half : self.half + self.n]

    def _drawn(self, across: Array, share: float) -> tuple[Any, tuple[FloatArray, ...]]:
        """Currents of the legs, and their derivatives d re / d re, d re / d im, d im / d re, d im / d im.

        With g = p h_p - j q h_q, I = g V and dg = k Re(conj(V) dV): see ``grid.three_phase_legs`` for h.
        """
        n_load, squared = len(self._load), np.maximum(np.abs(across) ** 2, TINY)
        inverse = np.sqrt(self._law[1] / squared[:n_load])
        (h_p, s_p), (h_q, s_q) = self.shares(inverse, *OF_P), self.shares(inverse, *OF_Q)
        p, q, of_v = self._load.real, self._load.imag, squared[:n_load]
        g: Any = np.concatenate((p * h_p + 1j * q * h_q, self._device / squared[n_load:]))
        k = np.concatenate(((p * s_p + 1j * q * s_q) / of_v, -2.0 * self._device / squared[n_load:] ** 2))
        re, im = across.real, across.imag
        to: Any = k * across
        slopes = (g.real + to.real * re, -g.imag + to.real * im, g.imag + to.imag * re, g.real + to.imag * im)
        return share * g * across, tuple(share * slope for slope in slopes)

    def shares(self, inverse: FloatArray, first: int, line: int, power: int) -> tuple[FloatArray, FloatArray]:
        """Return H of the legs and u h', of p or of q, from the shares, line and power in these rows of the law."""
        (z, i, c), (slope, offset) = self._law[first : first + 3], self._law[line : line + 2]
        _, floor, low, very_low = self._law[7:11]
        u = np.maximum(inverse, floor)
        h, to = z + u * (i + u * c), np.where(inverse >= floor, -inverse * (i + 2.0 * inverse * c), 0.0)
        inside = self._has_exponents & (inverse >= floor)
        raised = inverse ** self._law[power]
        h, to = np.where(inside, raised, h), np.where(inside, -self._law[power] * raised, to)
        h, to = np.where(inverse > low, slope + offset * inverse, h), np.where(inverse > low, -offset * inverse, to)
        is_z = self._is_z | (inverse > very_low)
        return np.where(is_z, 1.0, h), np.where(is_z, 0.0, to)

    def _real(self, values: Array, rows: np.ndarray, columns: np.ndarray) -> tuple[Any, Any, Any]:
        """Entries of complex equations as those of twice as many real ones."""
        half = self.half
        re, im = values.real, values.imag
        return (
            np.concatenate((re, -im, im, re)),
            np.concatenate((rows, rows, rows + half, rows + half)),
            np.concatenate((columns, columns + half, columns, columns + half)),
        )

    def _matrix(self, slopes: tuple[FloatArray, ...] | None = None) -> csc_matrix:
        """The derivative under these slopes of the legs' currents; without them what is linear in the equations."""
        n, half, (values, rows, columns) = self.n, self.half, self._linear
        if slopes is not None:
            kept = (self._rows < n) & (self._columns < n)
            below, right = self._rows[kept] + self.legs_at, self._columns[kept]
            signs = self.legs_sign * np.repeat((1.0, -1.0, -1.0, 1.0), len(self.ends))[kept]
            legs = [signs * np.tile(slope, 4)[kept] for slope in slopes]
            values = np.concatenate((values, *legs))
            rows = np.concatenate((rows, below, below, below + half, below + half))
            columns = np.concatenate((columns, right, right + half, right, right + half))
        return csc_matrix((values, (rows, columns)), (2 * half, 2 * half))


def high_voltage_solution(feeder: ThreePhaseFeeder, inputs: tuple[Any, ...]) -> FloatArray | None:
    """The solution of high voltage as ``solve_batch`` starts from it, (2 n_unknown,); None where none was found.

    ``inputs`` is one power flow as ``solve_batch`` takes it, without leading dimensions.
    """
    equations = Equations(feeder, *inputs)
    with np.errstate(all="ignore"):
        try:
            x, factors = equations.without_load()
        except RuntimeError:  # singular without load, as at the neutral of a star that only loads connect
            return None
        sign, carried, step = _sign(factors), 0.0, 1.0
        while carried < 1.0:
            step = min(step, 1.0 - carried)
            solution = _newton(equations, x, carried + step, sign)
            if solution is not None:
                x, carried = solution, carried + step
            elif step > LEAST_SHARE:
                step /= 2.0
            else:
                return None
    volts, n = equations.voltages(x), equations.n
    others = () if feeder.is_radial else (x[n : equations.half], x[equations.half + n :])
    return np.concatenate((volts.real, volts.imag, *others))


def _newton(equations: Equations, x: FloatArray, share: float, sign: float) -> FloatArray | None:
    """Solve for a share of the load from ``x``; None where the changes do not shrink or the sign is another."""
    before = np.inf
    for _ in range(MOST):
        missing, slope = equations.evaluate(x, share)
        try:
            factors = splu(slope)
        except RuntimeError:  # exactly singular, or not finite
            return None
        change = factors.solve(missing)
        size = np.abs(equations.voltages(change)).max()
        if not size < SHRINKS * before:
            return None
        x, before = x - change, size
        if size <= CLOSE_PU:
            return x if _sign(factors) == sign else None
    return None


def _sign(factors: SuperLU) -> float:
    """Sign of the determinant of a factored matrix; L has ones on its diagonal."""
    sign = np.prod(np.sign(factors.U.diagonal()))
    for order in (factors.perm_r, factors.perm_c):
        n = len(order)
        cycles = connected_components(csc_matrix((np.ones(n), (np.arange(n), order))), directed=False)[0]
        sign *= -1.0 if (n - cycles) % 2 else 1.0
    return float(sign)


def node_taps(feeder: ThreePhaseFeeder, ratio: Array) -> FloatArray:
    """Ratio of the regulator that feeds each node, 1 where none does."""
    plan = plan_of(feeder)
    tapped = (plan.kind == REGULATOR)[feeder.node_bus]
    return np.where(tapped, ratio[plan.regulator.astype(np.intp)] if len(ratio) else 1.0, 1.0)


@cached_on_owner
def places(feeder: ThreePhaseFeeder) -> Places:
    """Find the places of the entries of the branches' matrices in the equations."""
    first = feeder.first_node.astype(np.intp)
    size = np.diff(first)
    bus, i, j = (a.ravel() for a in np.meshgrid(np.arange(feeder.n_bus), range(3), range(3), indexing="ij"))
    there = (i < size[bus]) & (j < size[bus])
    bus, i, j = bus[there], i[there], j[there]
    column = first[bus] + j
    above = plan_of(feeder).up.astype(np.intp)[column]
    return Places(bus, 3 * i + j, first[bus] + i, column, above)


def _linear(feeder: ThreePhaseFeeder, ratio: Array, state: Array) -> tuple[Any, Any, Any]:
    """Complex entries of what is linear in V and I, with their rows and columns."""
    plan, n, place = plan_of(feeder), feeder.n_node, places(feeder)
    tap = node_taps(feeder, ratio)
    a = plan.a[place.bus, place.entry] * tap[place.row]
    b = (plan.z_re + 1j * plan.z_im)[place.bus, place.entry] * tap[place.row] * tap[place.column]
    receiving, nodes = place.bus > 0, np.arange(2 * n)
    parts = (
        (np.ones(2 * n), nodes, nodes),
        (-a[receiving], place.row[receiving], place.above[receiving]),
        (b, place.row, place.column + n),
        (-a[receiving], place.above[receiving] + n, place.row[receiving] + n),
        (-1j * plan.shunt[place.bus, place.entry], place.row + n, place.column),
        *((-y, row + n, column) for y, row, column in _shunts(feeder, state)),
    )
    values, rows, columns = (np.concatenate(one) for one in zip(*parts, strict=True))
    return values, rows, columns


def _shunts(feeder: ThreePhaseFeeder, state: Array) -> list[tuple[Any, Any, Any]]:
    """Admittances of capacitors and cores, with their nodes as rows and columns."""
    plan, n = plan_of(feeder), feeder.n_node
    i, j = np.concatenate((plan.capacitor_ends, plan.core_ends)).astype(np.intp).T
    banks = 1j * plan.capacitor_b * state[plan.capacitor_row.astype(np.intp)]
    y = np.concatenate((banks, plan.core_g + 1j * plan.core_b))
    parts = ((y, i, i), (-y, i, j), (-y, j, i), (y, j, j))
    return [(values[there], row[there], column[there]) for values, row, column in parts
            for there in ((row < n) & (column < n),)]  # fmt: skip
