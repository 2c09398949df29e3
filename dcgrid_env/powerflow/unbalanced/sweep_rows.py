"""Compiled solution of a batch: blocks of rows side by side, and one row at a time what does not settle there."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.powerflow.solution import V_SQ_FLOOR
from dcgrid_env.powerflow.unbalanced.nodal_kernels import copy_column
from dcgrid_env.powerflow.unbalanced.row_blocks import (
    active_devices,
    begin,
    load_row,
    start_row,
    store_rows,
    sweep_block,
    workspace,
)

ONE = (0,)
WIDE = (0,) * 32
"""Rows innermost, the tuple's length."""
FEW = 6  # up to this many rows one at a time beats a mostly empty block
BLOCK_SWEEPS = 30  # a row that needs more leaves its block, so that one near collapse does not hold up the rest
NOT_IN_BLOCKS = -1  # sweeps of a row that its block left without a solution
ROUNDING = 1e-28  # a squared change of voltage that is rounding alone
DIVERGED = 1e8  # a squared change of voltage that no sweep on its way to a solution has


@compiled(inner=True)
def error_sq(change, before):
    """Estimate the squared error left after a sweep by its squared change of voltage and that of the sweep before it.

    The sweeps converge by a ratio each, so that what is left is change * ratio / (1 - ratio); a ratio below a tenth is
    taken for luck.
    """
    if change <= ROUNDING:
        return change
    ratio = max(np.sqrt(change / before), 0.1)
    return change * (ratio / (1.0 - ratio)) ** 2 if ratio < 1.0 else np.inf


@compiled(inner=True)
def _clear(plan, work):
    """No solution at all: no current, and the lowest voltage."""
    V, J = work[0], work[1]
    for k in range(2 * plan.up.shape[0]):
        V[k] = 0.0 if k % 2 else np.sqrt(V_SQ_FLOOR)
        J[k] = 0.0


@compiled(nogil=True)
def sweep_blocks(plan, nodal, wide, inputs, start, tolerance_pu, max_sweeps, out):
    """Solve the rows of ``sweep_rows`` from their starts, in blocks of width ``wide``.

    Returns the number of rows that did not settle within BLOCK_SWEEPS; their sweeps are then NOT_IN_BLOCKS.
    """
    p_kw, q_kvar = inputs[0], inputs[1]
    tolerance_sq = tolerance_pu * tolerance_pu
    width, n_row, n_leg, n_node = len(wide), p_kw.shape[0], plan.leg_order.shape[0], plan.up.shape[0]
    work = workspace(plan, nodal, wide, inputs)
    off = work[10]
    nodes = np.empty(plan.up.shape[0], np.uint64)
    drawn = np.empty(plan.up.shape[0])
    done = np.empty(width, np.bool_)
    finite = np.empty(width, np.bool_)
    before = np.empty(width)
    columns = np.empty(width, np.uint64)
    sweeps = np.zeros(width, np.int64)
    settled_at = np.empty(width)
    volts = np.empty(0 if nodal is None else work[0].shape[0])
    most = min(BLOCK_SWEEPS, max_sweeps)
    for first in range(0, n_row, width):
        count = min(width, n_row - first)
        n_device = active_devices(p_kw, q_kvar, first, count, n_leg, drawn, nodes)
        for b in range(width):
            finite[b] = load_row(b, first + min(b, count - 1), plan, wide, inputs, nodes, n_device, work)
            done[b] = b >= count
            before[b] = 1.0
        begin(plan, nodal, wide, work)
        for b in range(width):
            start_row(b, first + min(b, count - 1), plan, nodal, wide, start, work)
        left = count
        stored = 0
        for sweep in range(1, most + 1):
            sweep_block(plan, nodal, wide, nodes, n_device, work)
            settled = 0
            for b in range(count):
                change = off[b]
                off[b] = error_sq(change, before[b])
                before[b] = change
                if done[b]:
                    continue
                if finite[b] and off[b] <= tolerance_sq:
                    columns[stored + settled] = b
                    settled += 1
                    sweeps[b] = sweep
                    settled_at[b] = off[b]
                    if nodal is not None:
                        copy_column(nodal, wide, np.uint64(n_node), np.uint64(b), work[0], volts)
                elif finite[b] and change <= DIVERGED and sweep < most:
                    continue
                else:
                    out[5][first + b] = 0
                done[b] = True
                left -= 1
            if nodal is not None:
                stored += settled  # all at once at the end, as the rest of the unknowns follows for a whole block
            elif settled > 0:
                store_rows(columns, settled, np.uint64(first), plan, nodal, wide, work, sweeps, True, out)
            if left == 0:
                break
        if stored > 0:
            for c in range(stored):
                off[columns[c]] = settled_at[columns[c]]
                if nodal is not None:
                    copy_column(nodal, wide, np.uint64(n_node), columns[c], volts, work[0])
            store_rows(columns, stored, np.uint64(first), plan, nodal, wide, work, sweeps, True, out)
    unsettled = 0
    for row in range(n_row):
        if out[5][row] <= 0:  # 0 where the voltages that it settled at cannot be
            out[5][row] = NOT_IN_BLOCKS
            unsettled += 1
    return unsettled


@compiled(inner=True)
def _one(row, plan, nodal, wide, inputs, start, tolerance_sq, max_sweeps, nodes, n_device, work):
    """Sweep one row in a block of width 1 to the tolerance; return the number of sweeps and whether it settled."""
    off, finite = work[10], True
    for b in range(len(wide)):  # no literal 0, for which the compiler would make a second version
        finite = load_row(b, row, plan, wide, inputs, nodes, n_device, work)
    off[0] = np.inf
    if not finite:
        return 0, False
    begin(plan, nodal, wide, work)
    start_row(0, row, plan, nodal, wide, start, work)
    before = 1.0
    for sweep in range(1, max_sweeps + 1):
        sweep_block(plan, nodal, wide, nodes, n_device, work)
        change = off[0]
        off[0] = error_sq(change, before)
        before = change
        if off[0] <= tolerance_sq:
            return sweep, True
        if not change <= DIVERGED:
            off[0] = np.inf
            return sweep, False
    return max_sweeps, False


@compiled(nogil=True)
def sweep_rows(plan, nodal, wide, inputs, start, tolerance_pu, max_sweeps, out):
    """Solve each row of ``inputs`` into the arrays of ``out``; return the number of rows without a solution.

    ``inputs`` holds p_kw, q_kvar (row, leg), source_pu (row,), the regulators' ratios (row, regulator) and the
    capacitors' states (row, bank); ``start`` voltages (row, 2 node), real parts first, or no rows. ``out`` holds
    v_pu (row, node), voltages in p.u. and currents in A (row, 2 node), loss, source power and residual (4, row),
    whether it converged, and sweeps (row,). A row that does not settle from its start is solved again from no load,
    with ``max_sweeps``. A row with positive sweeps has settled already and is skipped. A row with NOT_IN_BLOCKS skips
    its start.
    """
    p_kw, q_kvar = inputs[0], inputs[1]
    n_row, n_leg, n_node = p_kw.shape[0], plan.leg_order.shape[0], plan.up.shape[0]
    tolerance_sq = tolerance_pu * tolerance_pu
    work = workspace(plan, nodal, wide, inputs)
    nodes = np.empty(n_node, np.uint64)
    drawn = np.empty(n_node)
    column = np.zeros(1, np.uint64)
    of_row = np.zeros(1, np.int64)
    cold = start[:0]
    failed = 0
    for row in range(n_row):
        if out[5][row] > 0:
            continue
        place = np.uint64(row)
        n_device = active_devices(p_kw, q_kvar, row, 1, n_leg, drawn, nodes)
        if start.shape[0] > 0 and out[5][row] != NOT_IN_BLOCKS:
            most = min(BLOCK_SWEEPS, max_sweeps)
            sweeps, settled = _one(row, plan, nodal, wide, inputs, start, tolerance_sq, most, nodes, n_device, work)
            of_row[0] = sweeps
            if settled and store_rows(column, 1, place, plan, nodal, wide, work, of_row, settled, out) == 0:
                continue
        sweeps, settled = _one(row, plan, nodal, wide, inputs, cold, tolerance_sq, max_sweeps, nodes, n_device, work)
        of_row[0] = sweeps
        if work[10][0] == np.inf:
            _clear(plan, work)
        if settled:
            settled = store_rows(column, 1, place, plan, nodal, wide, work, of_row, settled, out) == 0
        if not settled:
            store_rows(column, 1, place, plan, nodal, wide, work, of_row, settled, out)
            failed += 1
    return failed
