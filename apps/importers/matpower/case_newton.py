"""MATPOWER's power flow on MATPOWER tables: bus admittance matrix and Newton's method in polar coordinates.

An import is compared with this solution, which is independent of the feeder tables.

References
----------
R. D. Zimmerman and C. E. Murillo-Sanchez, MATPOWER User's Manual, equations (3.10) to (3.13) and section 4.1.
W. F. Tinney and C. E. Hart, "Power Flow Solution by Newton's Method", IEEE Transactions on Power Apparatus and Systems,
PAS-86, 1967.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_STEPS = 40
_CLOSE_PU = 1e-8
"""Largest mismatch of power at a solution: MATPOWER's own tolerance; steps go on until they move nothing more."""
_STILL = 1e-10


@dataclass(frozen=True)
class CaseModel:
    """A case in per unit: branches and injections over rows of buses."""

    from_row: NDArray[np.intp]
    to_row: NDArray[np.intp]
    z_pu: ComplexArray
    charging_pu: FloatArray
    tap: ComplexArray
    shunt_pu: ComplexArray
    """Admittance to ground of each bus."""
    injection_pu: ComplexArray
    """Power that generators inject less what loads draw, shape (n_bus,)."""
    v_pu: FloatArray
    """Voltage kept at reference and PV buses, 1 elsewhere."""
    reference: NDArray[np.bool_]
    pv: NDArray[np.bool_]


def admittance(case: CaseModel) -> sparse.csr_matrix:
    """The bus admittance matrix."""
    n = len(case.shunt_pu)
    series = 1.0 / case.z_pu
    y_tt = series + 0.5j * case.charging_pu
    y_ff = y_tt / abs(case.tap) ** 2
    y_ft, y_tf = -series / np.conj(case.tap), -series / case.tap
    f, t, each = case.from_row, case.to_row, np.arange(n)
    values = np.concatenate([y_ff, y_ft, y_tf, y_tt, case.shunt_pu])
    rows, columns = np.concatenate([f, f, t, t, each]), np.concatenate([f, t, f, t, each])
    return sparse.csr_matrix((values, (rows, columns)), shape=(n, n))


@np.errstate(all="ignore")
def solved(case: CaseModel) -> tuple[ComplexArray, bool]:
    """Complex voltage of every bus, p.u., NaN where no reference bus feeds it, and whether it was found."""
    n = len(case.shunt_pu)
    links = sparse.csr_matrix((np.ones(len(case.from_row)), (case.from_row, case.to_row)), shape=(n, n))
    _, island = sparse.csgraph.connected_components(links, directed=False)
    live = np.isin(island, island[case.reference])
    pv, pq = np.flatnonzero(case.pv & live), np.flatnonzero(~case.pv & ~case.reference & live)
    free = np.concatenate([pv, pq])
    y = admittance(case)
    angle, size = _start_angle(case, live), np.where(case.pv | case.reference, case.v_pu, 1.0)
    moved = np.inf
    for _ in range(_STEPS):
        v = size * np.exp(1j * angle)
        current = y @ v
        wrong = v * np.conj(current) - case.injection_pu
        residual = np.concatenate([wrong.real[free], wrong.imag[pq]])
        if not np.all(np.isfinite(residual)):
            break
        if moved < _STILL and np.max(abs(residual), initial=0.0) < _CLOSE_PU:
            return np.where(live, v, np.nan), True
        try:
            step = splu(_slopes(y, v, current, free, pq)).solve(-residual)
        except RuntimeError:  # singular: past collapse
            break
        moved = np.max(abs(step), initial=0.0)
        angle[free] += step[: len(free)]
        size[pq] += step[len(free) :]
    return np.full(n, np.nan + 0j), False


def _start_angle(case: CaseModel, live: NDArray[np.bool_]) -> FloatArray:
    """Angles that phase shifts alone would give: from 0 everywhere, a shift of 150 degrees leads nowhere."""
    n, shift = len(case.shunt_pu), np.angle(case.tap)
    start, each = np.zeros(n), np.arange(len(shift))
    free = np.flatnonzero(live & ~case.reference)
    if not shift.any() or not len(free):
        return start
    ones = np.ones(len(shift))
    ends = (np.concatenate([ones, -ones]), (np.tile(each, 2), np.concatenate([case.from_row, case.to_row])))
    across = sparse.csc_matrix(ends, shape=(len(shift), n))[:, free]
    start[free] = splu((across.T @ across).tocsc()).solve(across.T @ shift)
    return start


def _slopes(
    y: sparse.csr_matrix, v: ComplexArray, current: ComplexArray, free: NDArray[np.intp], pq: NDArray[np.intp]
) -> Any:
    """Derivatives of the power at free buses with the angle at free and the magnitude at PQ buses."""
    voltage, unit = sparse.diags(v), sparse.diags(v / abs(v))
    by_angle: Any = (1j * voltage @ (sparse.diags(current) - y @ voltage).conj()).tocsr()
    by_size: Any = sparse.csr_matrix(voltage @ (y @ unit).conj() + sparse.diags(current.conj()) @ unit)
    blocks = [
        [by_angle[free][:, free].real, by_size[free][:, pq].real],
        [by_angle[pq][:, free].imag, by_size[pq][:, pq].imag],
    ]
    return sparse.bmat(blocks, format="csc")
