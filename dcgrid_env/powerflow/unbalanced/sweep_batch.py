"""From NumPy arrays of any leading shape to the compiled sweeps and back."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.threads import over_rows
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.unbalanced.nodal import Nodal, nodal_of
from dcgrid_env.powerflow.unbalanced.plan import Plan, plan_of
from dcgrid_env.powerflow.unbalanced.sweep_rows import FEW, ONE, WIDE, sweep_blocks, sweep_rows
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution

_NO_ROWS = np.empty((0, 0))


def solve_batch(
    feeder: ThreePhaseFeeder, inputs: tuple[Any, ...], start: Array | None, tolerance_pu: float, max_sweeps: int
) -> ThreePhaseSolution:
    """Run the sweeps over all rows, on several threads where there are many.

    ``inputs`` holds p_kw, q_kvar (..., n_leg), source_pu (...), ratios (..., n_regulator), states (..., n_capacitor).
    """
    shape, dtype, n = inputs[0].shape[:-1], inputs[0].dtype, feeder.n_node
    n_row = inputs[2].size
    rows = tuple(_rows(a, (n_row,) if k == 2 else (n_row, a.shape[-1])) for k, a in enumerate(inputs))
    start = _NO_ROWS if start is None else _rows(start, (n_row, 2 * feeder.n_unknown))
    out = (
        np.empty((n_row, n)),
        np.empty((n_row, 2 * feeder.n_unknown)),
        np.empty((n_row, 2 * n)),
        np.empty((4, n_row)),
        np.empty(n_row, np.bool_),
        np.zeros(n_row, np.int64),
    )
    plan, nodal, failed = plan_of(feeder), _nodal(feeder, rows), 0
    if n_row == 1:
        failed = sweep_rows(plan, nodal, ONE, rows, start, tolerance_pu, max_sweeps, out)
    elif n_row:
        failed = over_rows(partial(_part, plan, nodal, rows, start, tolerance_pu, max_sweeps, out), n_row)
    if failed:
        _solve_by_newton(feeder, rows, tolerance_pu, out)
    return _solution(out, shape, dtype, n)


def _nodal(feeder: ThreePhaseFeeder, rows: tuple[np.ndarray, ...]) -> Nodal | None:
    """The nodal equations for the devices that draw in any of these rows."""
    if feeder.is_radial:
        return None
    n = feeder.n_node
    return nodal_of(feeder, (rows[0][:, -n:] != 0.0).any(0) | (rows[1][:, -n:] != 0.0).any(0))


def _solve_by_newton(
    feeder: ThreePhaseFeeder, rows: tuple[np.ndarray, ...], tolerance_pu: float, out: tuple[np.ndarray, ...]
) -> None:
    """Try Newton's method where the sweep has failed; one sweep from its solution gives the figures and checks it."""
    from dcgrid_env.powerflow.unbalanced.newton import high_voltage_solution  # brings SciPy with it

    plan, nodal = plan_of(feeder), _nodal(feeder, rows)
    for row in np.flatnonzero(~out[4]):
        one = slice(row, row + 1)
        if not (np.isfinite(rows[0][row]).all() and np.isfinite(rows[1][row]).all()):
            continue
        volts = high_voltage_solution(feeder, tuple(a[row] for a in rows))
        if volts is None:
            continue
        solved = (*(np.empty_like(a[one]) for a in out[:3]), np.empty((4, 1)), np.empty(1, np.bool_), np.zeros(1, int))
        if sweep_rows(plan, nodal, ONE, tuple(a[one] for a in rows), volts[None], tolerance_pu, 1, solved) == 0:
            for figures, of_row in zip(_cut(out, one), solved, strict=True):
                figures[...] = of_row


def _part(
    plan: Plan,
    nodal: Nodal | None,
    rows: tuple[Array, ...],
    start: Array,
    tolerance: float,
    max_sweeps: int,
    out: tuple[np.ndarray, ...],
    first: int,
    last: int,
) -> int:
    cut = slice(first, last)
    part = _cut(out, cut)
    per_row = part[3].copy()  # contiguous, as the kernel takes it
    inputs, start, figures = tuple(a[cut] for a in rows), start[cut], (*part[:3], per_row, *part[4:])
    # Two kernels and not one, so that a single environment does not compile what many need.
    failed = last - first
    if failed > FEW:
        failed = sweep_blocks(plan, nodal, WIDE, inputs, start, tolerance, max_sweeps, figures)
    if failed:
        failed = sweep_rows(plan, nodal, ONE, inputs, start, tolerance, max_sweeps, figures)
    part[3][...] = per_row
    return failed


def _cut(out: tuple[np.ndarray, ...], rows: slice) -> tuple[Any, ...]:
    """Views of the figures of some rows."""
    return (*(a[rows] for a in out[:3]), out[3][:, rows], *(a[rows] for a in out[4:]))


def _solution(out: tuple[np.ndarray, ...], shape: tuple[int, ...], dtype: Any, n: int) -> ThreePhaseSolution:
    v_pu, volts, amperes, per_row, converged, iterations = out
    if dtype != np.float64:
        v_pu, volts, amperes, per_row = (a.astype(dtype) for a in (v_pu, volts, amperes, per_row))
    if len(shape) != 1:
        v_pu, volts, amperes = (a.reshape(*shape, a.shape[-1]) for a in (v_pu, volts, amperes))
        per_row = per_row.reshape(4, *shape)
        converged, iterations = converged.reshape(shape)[()], iterations.reshape(shape)[()]
    loss, p, q, residual = per_row
    return ThreePhaseSolution(
        v_pu,
        volts[..., :n],
        volts[..., n : 2 * n],
        amperes[..., :n],
        amperes[..., n:],
        loss,
        p,
        q,
        converged,
        iterations,
        residual,
        restart=volts,
    )


def _rows(values: Array, shape: tuple[int, ...]) -> np.ndarray:
    """Contiguous, writable and float64: the one memory layout that the kernels are compiled for."""
    rows = values if values.shape == shape else values.reshape(shape)
    flags = rows.flags
    good = rows.dtype == np.float64 and flags.c_contiguous and flags.writeable
    return rows if good else np.array(rows, np.float64, order="C")
