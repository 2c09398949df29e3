"""Compiled DistFlow sweeps of a weakly meshed feeder, whose loops are opened and compensated: see ``looped``.

After each sweep of the opened feeder, the power through each break point changes by what the difference of the two
voltages there asks for. Sweeps and compensation converge together. As in ``distflow_kernels``, there is a form for one
row and one for blocks of rows, and a row has the same bits in both.

``loops`` are the constants of ``looped.Loops`` in depth-first order of the opened feeder.
"""

from __future__ import annotations

import math

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.core.units import S_BASE_KVA
from dcgrid_env.powerflow.balanced.compiled_blocks import (
    BLOCK,
    BLOCK_SWEEPS,
    NOT_IN_BLOCKS,
    _load_block,
    _store_block,
    _store_flows,
    _sweep,
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
def _compensate(b, loops, parent, r, x, p, q, P, Q, v, power, gap, angle):
    """Change the power through the break points of column b, per unit; return the largest change.

    ``power`` adds up the power through each break point, active and reactive. ``gap`` and ``angle`` are scratch.
    """
    end, to, first, branch, sign, y_re, y_im = loops
    for m in range(end.shape[0]):
        turned = 0.0
        for i in range(first[m], first[m + 1]):
            k = branch[i]
            p_k, q_k = P[k, b], Q[k, b]
            in_phase = v[parent[k], b] - r[k] * p_k - x[k] * q_k
            turned += sign[i] * math.atan2(x[k] * p_k - r[k] * q_k, in_phase)
        gap[m] = 0.5 * (v[end[m], b] - v[to[m], b])
        angle[m] = -turned * v[to[m], b]
    largest = 0.0
    for m in range(end.shape[0]):
        active = reactive = 0.0
        for i in range(end.shape[0]):
            active += y_re[m, i] * gap[i] - y_im[m, i] * angle[i]
            reactive -= y_re[m, i] * angle[i] + y_im[m, i] * gap[i]
        p[end[m], b] += active
        q[end[m], b] += reactive
        p[to[m], b] -= active
        q[to[m], b] -= reactive
        power[m, 0, b] += active
        power[m, 1, b] += reactive
        largest = max(largest, abs(active), abs(reactive))
    return largest


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

    The radial kernel has the same sweep in its loop: as a function of its own it takes a tenth more time there.
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
    if shunt_g.shape[0] > 0:
        off[0] = residual
        _add_change(shunt_g, shunt_b, v, before, off)
        residual = off[0]
    return residual


@compiled(inner=True)
def _row(parent, r, x, shunt_g, shunt_b, loops, scratch, power, before, off, gap, angle, tolerance, max_sweeps):
    """Sweep and compensate one feeder (column 0) to the tolerance; (sweeps, residual), inf on a collapse."""
    p, q, P, Q, v, _ = scratch
    residual = np.inf
    for sweep in range(1, max_sweeps + 1):
        residual = _sweep_row(parent, r, x, shunt_g, shunt_b, scratch, before, off)
        if residual == np.inf:
            return sweep, residual
        residual = max(residual, _compensate(0, loops, parent, r, x, p, q, P, Q, v, power, gap, angle))
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
    work = np.empty((6, n, 1))
    scratch = (work[0], work[1], work[2], work[3], work[4], work[5])
    power, gap, angle = np.empty((n_loop, 2, 1)), np.empty(n_loop), np.empty(n_loop)
    before, off = np.empty((shunt_g.shape[0], 1)), np.empty(1)
    p, q, _, _, _, l = scratch
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
            sweeps, residual = _row(
                parent, r, x, shunt_g, shunt_b, loops, scratch, power, before, off, gap, angle, tolerance, most
            )
        if finite and not residual <= tolerance:
            _load(0, row, order, p_kw, q_kvar, v0_pu, scratch)
            _start(0, row, order, cold, l)
            _start_power(0, row, loops, cold, p, q, power)
            sweeps, residual = _row(
                parent, r, x, shunt_g, shunt_b, loops, scratch, power, before, off, gap, angle, tolerance, max_sweeps
            )
        settled = residual <= tolerance
        failed += not settled
        if residual == np.inf:
            _clear(scratch)
            power[:] = 0.0
        _store(0, row, order, r, ratio, scratch, sweeps, residual, settled, out)
        _store_restart(0, row, order, scratch[5], power, restart)
    return failed


@compiled(nogil=True)
def looped_blocks(
    order, parent, r, x, shunt_g, shunt_b, ratio, loops, p_kw, q_kvar, v0_pu, warm, tolerance, max_sweeps, out, restart
):
    """Solve what ``looped_rows`` solves in blocks of rows; return the number of rows that did not settle in them.

    Their iterations are then NOT_IN_BLOCKS.
    """
    v_pu, p_branch_kw, q_branch_kvar, current_sq_pu, loss_kw, ok, iterations, residual_kva = out
    n_row, n = p_kw.shape
    n_loop = loops[0].shape[0]
    powers, work = np.empty((2, n, 2 * BLOCK)), np.empty((2, n, BLOCK))
    load, flow, v, l = powers[0], powers[1], work[0], work[1]
    p, q, P, Q = load[:, :BLOCK], load[:, BLOCK:], flow[:, :BLOCK], flow[:, BLOCK:]
    rows = np.empty((4, BLOCK))
    live, off, v_up, collapsed = rows[0], rows[1], rows[2], rows[3]
    power, gap, angle = np.empty((n_loop, 2, BLOCK)), np.empty(n_loop), np.empty(n_loop)
    before = np.empty((shunt_g.shape[0], BLOCK))
    finite, settled = np.empty(BLOCK, np.bool_), np.empty(BLOCK, np.bool_)
    most = min(BLOCK_SWEEPS, max_sweeps)
    for first in range(0, n_row, BLOCK):
        left = count = min(BLOCK, n_row - first)
        last = first + count - 1
        _load_block(first, last, order, p_kw, q_kvar, v0_pu, warm, shunt_g.shape[0], load, v, l, finite)
        for b in range(BLOCK):
            live[b] = 1.0
            _start_power(b, min(first + b, last), loops, warm, p, q, power)
        iterations[first : last + 1] = NOT_IN_BLOCKS
        for sweep in range(1, most + 1):
            _sweep(parent, r, x, shunt_g, shunt_b, load, flow, v, l, before, live, off, collapsed, v_up)
            for b in range(BLOCK):
                settled[b] = False
                if live[b] > 0.0:
                    gone = collapsed[b] > 0.0 or not finite[b]
                    if not gone:
                        change = _compensate(b, loops, parent, r, x, p, q, P, Q, v, power, gap, angle)
                        off[b] = max(off[b], change)
                        settled[b] = off[b] <= tolerance
                    if settled[b] or gone:
                        live[b] = 0.0
                        left -= b < count
                if settled[b] and b < count:
                    ok[first + b] = True
                    iterations[first + b] = sweep
                    residual_kva[first + b] = off[b] * S_BASE_KVA
            _store_flows(first, settled[:count], order, flow, p_branch_kw, q_branch_kvar)
            if left == 0:
                break
        _store_block(first, last, order, r, ratio, v, l, v_pu, current_sq_pu, loss_kw)
        for b in range(count):
            _store_restart(b, first + b, order, l, power, restart)
    unsettled = 0
    for row in range(n_row):
        unsettled += iterations[row] == NOT_IN_BLOCKS
    return unsettled
