"""Compiled DistFlow sweeps of a weakly meshed feeder, whose loops are opened and compensated: see ``looped``.

After each sweep of the opened feeder, the power through each break point is corrected by the difference of its two
voltages. Sweeps and compensation converge together. As in ``distflow_kernels``, there is a form for one row and one for
blocks of rows, and a row has the same bits in both. Scratch arrays are those of ``compiled_blocks``.

``loops`` are the constants of ``looped.Loops`` in depth-first order of the opened feeder.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.powerflow.balanced.compiled_blocks import (
    BLOCK,
    BLOCK_SWEEPS,
    NOT_IN_BLOCKS,
    WIDTH,
    _load_block,
    _store_settled,
    _sweep,
    _tree,
)
from dcgrid_env.powerflow.balanced.distflow_kernels import _add_change, _add_shunts, _clear, _load, _start, _store
from dcgrid_env.powerflow.solution import V_SQ_CEILING, V_SQ_FLOOR


@compiled(inner=True)
def _start_power(b, row, loops, warm, p, q, power):
    """Add the power of a row's start, or none, to the loads of column b on both sides of each break point."""
    end, to = loops[0], loops[1]
    first = warm.shape[1] - 2 * end.shape[0]
    for m in range(end.shape[0]):
        active = reactive = 0.0
        if warm.shape[0] > 0:
            active, reactive = warm[row, first + 2 * m], warm[row, first + 2 * m + 1]
        power[m, 0, b], power[m, 1, b] = active, reactive
        p[end[m], b] += active
        q[end[m], b] += reactive
        p[to[m], b] -= active
        q[to[m], b] -= reactive


@compiled(inner=True)
def _turn(first, last, loops, parent, r, x, P, Q, v, re, im):
    """Fill ``re`` and ``im`` with the voltage at the end of a path, divided by the one at its beginning."""
    branch, width = loops[4], re.shape[0]
    for b in range(width):
        re[b], im[b] = 1.0, 0.0
    for i in range(first, last):
        k = branch[i]
        r_k, x_k, u = r[k], x[k], parent[k]
        for b in range(width):
            active, reactive = P[k, b], Q[k, b]
            along = 1.0 - (r_k * active + x_k * reactive) / v[u, b]
            across = (r_k * reactive - x_k * active) / v[u, b]
            re[b], im[b] = re[b] * along - im[b] * across, re[b] * across + im[b] * along


@compiled(inner=True)
def _compensate(loops, parent, r, x, p, q, P, Q, v, live, power, gap, turn, change):
    """Change the power through the break points of the live columns, per unit; ``change`` is the largest of a column.

    ``power`` adds up the power through each break point. ``gap`` and ``turn`` are scratch.
    """
    end, to, first, middle, _, meet, y_re, y_im = loops
    width = live.shape[0]
    for m in range(end.shape[0]):
        _turn(first[m], middle[m], loops, parent, r, x, P, Q, v, turn[0], turn[1])
        _turn(middle[m], first[m + 1], loops, parent, r, x, P, Q, v, turn[2], turn[3])
        for b in range(width):
            square = v[meet[m], b]
            gap[m, 0, b] = (turn[0, b] * turn[2, b] + turn[1, b] * turn[3, b]) * square - v[to[m], b]
            gap[m, 1, b] = (turn[1, b] * turn[2, b] - turn[0, b] * turn[3, b]) * square
    for b in range(width):
        change[b] = 0.0
    for m in range(end.shape[0]):
        for b in range(width):
            turn[0, b] = turn[1, b] = 0.0
        for i in range(end.shape[0]):
            g, h = y_re[m, i], y_im[m, i]
            for b in range(width):
                turn[0, b] += g * gap[i, 0, b] - h * gap[i, 1, b]
                turn[1, b] -= g * gap[i, 1, b] + h * gap[i, 0, b]
        for b in range(width):
            active = turn[0, b] if live[b] else 0.0
            reactive = turn[1, b] if live[b] else 0.0
            p[end[m], b] += active
            q[end[m], b] += reactive
            p[to[m], b] -= active
            q[to[m], b] -= reactive
            power[m, 0, b] += active
            power[m, 1, b] += reactive
            change[b] = max(change[b], max(abs(active), abs(reactive)))


@compiled(inner=True)
def _store_restart(b, row, order, l, power, restart):
    """Write the start that column b gives a similar power flow."""
    for k in range(1, order.shape[0]):
        restart[row, order[k] - 1] = l[k, b]
    for m in range(power.shape[0]):
        restart[row, order.shape[0] - 1 + 2 * m] = power[m, 0, b]
        restart[row, order.shape[0] + 2 * m] = power[m, 1, b]


@compiled(inner=True)
def _sweep_row(parent, r, x, shunt_g, shunt_b, scratch, before, off):
    """Sweep one opened feeder (column 0 of the scratch) once; return the residual, inf on a collapse.

    The radial kernel has the same sweep in its loop, because a separate function takes a tenth more time there.
    """
    p, q, P, Q, v, l = scratch
    n = parent.shape[0]
    for k in range(n):
        P[k, 0] = p[k, 0] + r[k] * l[k, 0]
        Q[k, 0] = q[k, 0] + x[k] * l[k, 0]
    _add_shunts(shunt_g, shunt_b, scratch, before)
    for k in range(n - 1, 0, -1):
        P[parent[k], 0] += P[k, 0]
        Q[parent[k], 0] += Q[k, 0]
    residual = 0.0
    for k in range(1, n):
        v_i = v[parent[k], 0]
        l_new = (P[k, 0] * P[k, 0] + Q[k, 0] * Q[k, 0]) / v_i
        v_j = v_i - 2.0 * (r[k] * P[k, 0] + x[k] * Q[k, 0]) + (r[k] * r[k] + x[k] * x[k]) * l_new
        if not (v_j > V_SQ_FLOOR and v_j < V_SQ_CEILING):
            return np.inf
        residual = max(residual, abs(l_new - l[k, 0]) * max(r[k], x[k]))
        l[k, 0] = l_new
        v[k, 0] = v_j
    off[0] = residual
    _add_change(shunt_g, shunt_b, v, before, off)
    return off[0]


@compiled(inner=True)
def _row(parent, r, x, shunt_g, shunt_b, loops, scratch, power, work, tolerance, max_sweeps):
    """Sweep and compensate one feeder to the tolerance; (sweeps, residual), inf on a collapse."""
    before, live, off, change, gap, turn = work
    p, q, P, Q, v, _ = scratch
    live[0] = True
    residual = np.inf
    for sweep in range(1, max_sweeps + 1):
        residual = _sweep_row(parent, r, x, shunt_g, shunt_b, scratch, before, off)
        if residual == np.inf:
            return sweep, residual
        _compensate(loops, parent, r, x, p, q, P, Q, v, live, power, gap, turn, change)
        residual = max(residual, change[0])
        if residual <= tolerance:
            return sweep, residual
    return max_sweeps, residual


@compiled(nogil=True)
def looped_rows(
    order, parent, r, x, shunt_g, shunt_b, ratio, loops, p_kw, q_kvar, v0_pu, warm, tolerance, max_sweeps, out, restart
):
    """Solve each row of loads (row, bus of the opened feeder), as ``distflow_rows`` does.

    ``warm`` and ``restart`` (row, branch + 2 loop) hold squared currents, then active and reactive power through each
    break point, per unit.
    """
    n_row, n = p_kw.shape
    n_loop = loops[0].shape[0]
    arrays = np.empty((6, n, 1))
    scratch = (arrays[0], arrays[1], arrays[2], arrays[3], arrays[4], arrays[5])
    p, q, l = scratch[0], scratch[1], scratch[5]
    power, before, columns = np.empty((n_loop, 2, 1)), np.empty((shunt_g.shape[0], 1)), np.empty((2, 1))
    work = (before, np.empty(1, np.bool_), columns[0], columns[1], np.empty((n_loop, 2, 1)), np.empty((4, 1)))
    cold = warm[:0]
    failed = 0
    for row in range(n_row):
        if out[6][row] > 0:
            continue
        sweeps, residual = 0, np.inf
        finite = _load(0, row, order, p_kw, q_kvar, v0_pu, scratch)
        if finite and out[6][row] != NOT_IN_BLOCKS:
            _start(0, row, order, warm, l)
            _start_power(0, row, loops, warm, p, q, power)
            most = min(BLOCK_SWEEPS, max_sweeps)
            sweeps, residual = _row(parent, r, x, shunt_g, shunt_b, loops, scratch, power, work, tolerance, most)
        if finite and not residual <= tolerance:
            _load(0, row, order, p_kw, q_kvar, v0_pu, scratch)
            _start(0, row, order, cold, l)
            _start_power(0, row, loops, cold, p, q, power)
            sweeps, residual = _row(parent, r, x, shunt_g, shunt_b, loops, scratch, power, work, tolerance, max_sweeps)
        settled = residual <= tolerance
        failed += not settled
        if residual == np.inf:
            _clear(scratch)
            power[:] = 0.0
        _store(0, row, order, r, ratio, scratch, sweeps, residual, settled, out)
        _store_restart(0, row, order, l, power, restart)
    return failed


@compiled(nogil=True)
def looped_blocks(
    order, parent, r, x, shunt_g, shunt_b, ratio, loops, p_kw, q_kvar, v0_pu, warm, tolerance, max_sweeps, out, restart
):
    """Solve what ``looped_rows`` solves in blocks of rows; return the number of rows that did not settle in them.

    Their iterations are then NOT_IN_BLOCKS.
    """
    ok, iterations, residual_kva = out[5], out[6], out[7]
    n_row, n = p_kw.shape
    n_loop = loops[0].shape[0]
    tree, work, rows = _tree(parent), np.empty((6, n, WIDTH)), np.empty((3, BLOCK))
    p, q, P, Q, v, l = work[0], work[1], work[2], work[3], work[4], work[5]
    off, v_up, change = rows[0], rows[1], rows[2]
    power, gap, turn = np.empty((n_loop, 2, BLOCK)), np.empty((n_loop, 2, BLOCK)), np.empty((4, BLOCK))
    before = np.empty((shunt_g.shape[0], BLOCK))
    live, settled = np.empty(BLOCK, np.bool_), np.empty(BLOCK, np.bool_)
    unsettled = 0
    for first in range(0, n_row, BLOCK):
        count = min(BLOCK, n_row - first)
        last = first + count - 1
        _load_block(first, last, order, p_kw, q_kvar, v0_pu, warm, shunt_g.shape[0], p, q, v, l, live)
        for b in range(BLOCK):
            _start_power(b, min(first + b, last), loops, warm, p, q, power)
        live[count:] = False
        iterations[first : last + 1] = NOT_IN_BLOCKS
        left = live.sum()
        unsettled += count
        for sweep in range(1, min(BLOCK_SWEEPS, max_sweeps) + 1):
            if left == 0:
                break
            _sweep(tree, r, x, shunt_g, shunt_b, p, q, P, Q, v, l, before, off, v_up)
            for b in range(BLOCK):
                if live[b] and off[b] == np.inf:
                    live[b] = False
                    left -= 1
            _compensate(loops, parent, r, x, p, q, P, Q, v, live, power, gap, turn, change)
            n_settled = 0
            for b in range(BLOCK):
                off[b] = max(off[b], change[b])
                settled[b] = live[b] and off[b] <= tolerance
                if settled[b]:
                    live[b] = False
                    left -= 1
                    n_settled += 1
                    ok[first + b] = True
                    iterations[first + b] = sweep
                    residual_kva[first + b] = off[b] * S_BASE_KVA
                    _store_restart(b, first + b, order, l, power, restart)
            if n_settled > 0:
                _store_settled(first, settled, order, r, ratio, P, Q, v, l, out)
                unsettled -= n_settled
    return unsettled
