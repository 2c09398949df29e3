"""An interior-point method for linear programs of hinges, whose normal matrix is banded.

    minimise  c'x + sum_i h_i max(a_i'x - k_i, 0)        over x, h_i > 0, infinite where a_i'x <= k_i must hold

With s_i, t_i >= 0 the distances below and above k_i, a_i'x - t_i + s_i = k_i, and z_i in [0, h_i] the multipliers, the
optimum has

    c + A'z = 0,    z_i s_i = 0,    (h_i - z_i) t_i = 0

towards which Newton steps are made with predictor and corrector (S. Mehrotra, "On the implementation of a primal-dual
interior point method", SIAM Journal on Optimization 2, 1992; with bounded multipliers as in S. Portnoy and R. Koenker,
"The Gaussian hare and the Laplacian tortoise", Statistical Science 12, 1997). Each solves A'D A dx = r with D diagonal.
In a program over time, rows connect one step with the next, so the band is as wide as two steps. The time is
proportional to the number of steps; the simplex method's grows with its square or more.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve_banded, cholesky_banded

STEPS = 100
"""Newton steps at most."""
TOLERANCE = 1e-6
"""Gap between the objective and its bound, and what is missing of either's constraints, as shares, at the end."""
_TOWARDS = 0.9995  # of the way to where a distance or a multiplier would be nothing


class Rows(NamedTuple):
    """All a_i: some that are dense in the unknowns of one step, and others."""

    dense: np.ndarray
    """Rows of each step by the quantities of that step, (T, n, k)."""
    quantities: Any
    """These quantities of all steps by the unknowns, sparse, (T k, n_x)."""
    times: tuple[float, ...]
    """Signs of the dense rows in the program, one copy of all rows for each."""
    other: Any
    """The rows behind them, sparse, (m, n_x)."""
    width: int
    """Largest distance of two unknowns of a row."""

    def apply(self, x: np.ndarray) -> np.ndarray:
        """A x."""
        steps, _, k = self.dense.shape
        product = (self.dense @ (self.quantities @ x).reshape(steps, k, 1))[..., 0]
        return np.concatenate([*((sign * product).ravel() for sign in self.times), self.other @ x])

    def transposed(self, z: np.ndarray) -> np.ndarray:
        """A' z."""
        copies, rest = self._split(z)
        summed = np.einsum("c,ctn->tn", self.times, copies)
        by_step = (summed[:, None] @ self.dense).ravel()
        return self.quantities.T @ by_step + self.other.T @ rest

    def normal(self, weights: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """What solves A' D A x = r for x, D the diagonal matrix of the weights."""
        copies, rest = self._split(weights)
        steps, _, k = self.dense.shape
        blocks = np.swapaxes(self.dense, 1, 2) @ (self.dense * np.sum(copies, axis=0)[..., None])
        rows, columns = np.divmod(np.arange(k * k), k)
        of_step = k * np.arange(steps)[:, None]
        where = (of_step + rows).ravel(), (of_step + columns).ravel()
        whole = sparse.csr_array((blocks.ravel(), where), shape=(steps * k, steps * k))
        by_other: Any = self.other.T @ sparse.diags_array(rest) @ self.other
        entries = sparse.tril(self.quantities.T @ whole @ self.quantities + by_other).tocoo()
        banded = np.zeros((self.width + 1, self.quantities.shape[1]))
        banded[entries.row - entries.col, entries.col] = entries.data
        factor = cholesky_banded(banded, overwrite_ab=True, lower=True, check_finite=False)
        return lambda right: cho_solve_banded((factor, True), right, check_finite=False)

    def _split(self, values: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
        steps, n, _ = self.dense.shape
        ends = steps * n * np.arange(len(self.times) + 1)
        return [values[a:b].reshape(steps, n) for a, b in itertools.pairwise(ends)], values[ends[-1] :]


class Optimum(NamedTuple):
    """What was found."""

    x: np.ndarray
    value: float
    """The objective."""
    bound: float
    """Lower bound for every x, apart from rounding."""
    steps: int
    """Newton steps made."""


def minimise(
    c: np.ndarray,
    rows: Rows,
    h: np.ndarray,
    k: np.ndarray,
    x: np.ndarray,
    constant: float = 0.0,
    tolerance: float = TOLERANCE,
) -> Optimum:
    """Solve the program from ``x`` on, which need not keep any constraint; ``constant`` is added to the objective.

    Raises
    ------
    ArithmeticError
        Where no optimum was found, as of a program whose constraints exclude each other.
    """
    state, hard = _starting_point(rows, h, k, x), np.isinf(h)
    largest = max(float(np.abs(k[hard]).max(initial=1.0)), 1.0)
    for done in range(STEPS + 1):
        above = rows.apply(state.x) - k
        missing = _Missing(state.t - state.s - above, -c - rows.transposed(state.z))
        value = constant + float(c @ state.x + h[~hard] @ np.maximum(above[~hard], 0.0))
        bound = constant - float(k @ state.z)
        beyond = float(np.maximum(above[hard], 0.0).max(initial=0.0))
        off = max(abs(value - bound), float(np.abs(missing.dual * state.x).sum()))
        if off <= tolerance * abs(value) and beyond <= tolerance * largest:
            return Optimum(state.x, value, bound, done)
        if done == STEPS or not np.isfinite(off):
            break
        try:
            state = _step(state, missing, rows)
        except np.linalg.LinAlgError:
            break
    raise ArithmeticError(f"no optimum in {STEPS} Newton steps; the constraints may exclude each other")


class _Missing(NamedTuple):
    """What is missing of the constraints."""

    primal: np.ndarray
    dual: np.ndarray


class _State(NamedTuple):
    """x, distances below and above, multipliers and what they are below their limit; of hard rows t = 0 and y = 1."""

    x: np.ndarray
    s: np.ndarray
    t: np.ndarray
    z: np.ndarray
    y: np.ndarray
    soft: np.ndarray
    """1 for a row with a finite price and 0 for a hard one."""

    def product(self) -> float:
        """Mean of the products that are 0 at the optimum."""
        return float(self.s @ self.z + self.t @ self.y) / (len(self.s) + float(self.soft.sum()))


def _starting_point(rows: Rows, h: np.ndarray, k: np.ndarray, x: np.ndarray) -> _State:
    """Multipliers in the middle of their range, and distances that make all products alike where x lets them."""
    soft, off = np.isfinite(h), rows.apply(x) - k
    price = np.where(soft, h, 1.0)
    product = 0.25 * float((price * np.abs(off))[soft].mean()) if soft.any() else 1.0
    apart = 2.0 * product / price
    room = np.maximum(-off, 0.1 * float(np.abs(off[~soft]).mean()) if not soft.all() else 0.0)
    s = np.where(soft, np.maximum(-off, 0.0) + apart, room)
    t = np.where(soft, np.maximum(off, 0.0) + apart, 0.0)
    z = np.where(soft, 0.5 * price, product / s)
    return _State(x, s, t, z, np.where(soft, 0.5 * price, 1.0), soft.astype(np.float64))


def _step(state: _State, missing: _Missing, rows: Rows) -> _State:
    """A predictor, and a corrector towards a product that is as much smaller as the predictor found it could be."""
    below, above = state.s / state.z, state.t / state.y
    weights = 1.0 / (below + above)
    solve = rows.normal(weights)

    def newton(of_s: np.ndarray, of_t: np.ndarray) -> tuple[np.ndarray, ...]:
        """Changes of x, s, t and z at which the products change by what is given."""
        of_s, of_t = of_s / state.z, state.soft * of_t / state.y
        wanted = missing.primal - of_s + of_t
        dx = solve(missing.dual + rows.transposed(weights * wanted))
        dz = weights * (rows.apply(dx) - wanted)
        return dx, of_s - below * dz, of_t + above * dz, dz

    _, ds, dt, dz = newton(-state.s * state.z, -state.t * state.y)
    primal, dual = _lengths(state, ds, dt, dz, 1.0)
    after = state._replace(
        s=state.s + primal * ds, t=state.t + primal * dt, z=state.z + dual * dz, y=state.y - state.soft * dual * dz
    ).product()
    now = state.product()
    towards = now * (after / now) ** 3
    dx, ds, dt, dz = newton(towards - state.s * state.z - ds * dz, towards - state.t * state.y + dt * dz)
    primal, dual = _lengths(state, ds, dt, dz, _TOWARDS)
    return _State(
        state.x + primal * dx,
        state.s + primal * ds,
        state.t + primal * dt,
        state.z + dual * dz,
        state.y - state.soft * dual * dz,
        state.soft,
    )


def _lengths(state: _State, ds: np.ndarray, dt: np.ndarray, dz: np.ndarray, share: float) -> tuple[float, float]:
    """How far distances, and multipliers, may go along their changes, as shares of these and 1 at most."""

    def farthest(*pairs: tuple[np.ndarray, np.ndarray]) -> float:
        steepest = max(float((-change / value).max(initial=0.0)) for value, change in pairs)
        return min(1.0, share / steepest) if steepest > 0.0 else 1.0

    soft = state.soft > 0.0
    return farthest((state.s, ds), (state.t[soft], dt[soft])), farthest((state.z, dz), (state.y, -state.soft * dz))
