"""Compiled DistFlow sweeps of many feeders at once: the innermost loops run over a block of feeders, as vectors.

Arithmetic and conventions are those of ``distflow_kernels``, so results have the same bits in both. Scratch arrays are
(n_bus, BLOCK) in depth-first order and per unit. ``load`` and ``flow`` are (n_bus, 2 BLOCK): active power in the first
half of a row and reactive power in the second, so one loop adds both up.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.core.units import S_BASE_KVA
from dcgrid_env.powerflow.solution import V_SQ_CEILING, V_SQ_FLOOR

TILE = 8  # rows that are put into a block, or taken from it, side by side: a cache line of columns
BLOCK = 8 * TILE  # rows innermost; of 8, 16, 32 and 64 the fastest on ieee123
FEW = 10  # up to this many rows one at a time beats a mostly empty block
MOST_IN_BLOCKS = 3000  # buses: a block is three times as fast there as one row at a time, and no faster at 10,000
BLOCK_SWEEPS = 30  # a row that needs more leaves its block, so that one near collapse does not hold up the rest
NOT_IN_BLOCKS = -1  # iterations of a row that its block left without a solution
PER_KVA = 1.0 / S_BASE_KVA


@compiled(inner=True)
def _load_block(first, last, order, p_kw, q_kvar, v0_pu, warm, n_shunts, load, v, l, finite):
    """Put loads and start of the rows ``first`` to ``last`` into the columns; repeat ``last`` in the remaining columns.

    The loop handles a few rows at a time, and of these one bus at a time, so reads and writes are both nearly
    contiguous. ``finite`` is set to whether all loads of a row are finite.
    """
    check = np.zeros(BLOCK, p_kw.dtype)
    for tile in range(0, BLOCK, TILE):
        for k in range(order.shape[0]):
            i = order[k]
            for b in range(tile, tile + TILE):
                row = min(first + b, last)
                p, q = p_kw[row, i] * PER_KVA, q_kvar[row, i] * PER_KVA
                load[k, b], load[k, BLOCK + b] = p, q
                check[b] += 0.0 * p + 0.0 * q
        l[0, tile : tile + TILE] = 0.0
        if warm.shape[0] > 0:
            for k in range(1, order.shape[0]):
                for b in range(tile, tile + TILE):
                    l[k, b] = warm[min(first + b, last), order[k] - 1]
        else:
            l[:, tile : tile + TILE] = 0.0
    for b in range(BLOCK):
        finite[b] = check[b] == 0.0
        v0 = v0_pu[min(first + b, last)]
        v[0, b] = v0 * v0
        for k in range(n_shunts):  # the first sweep takes their power at this voltage
            v[k, b] = v0 * v0


@compiled(inner=True)
def _store_flows(first, settled, order, flow, p_branch_kw, q_branch_kvar):
    """Write the flows of the rows that have settled in this sweep: the next one changes them."""
    for b in range(settled.shape[0]):
        if settled[b]:
            for k in range(1, order.shape[0]):
                p_branch_kw[first + b, order[k] - 1] = flow[k, b] * S_BASE_KVA
                q_branch_kvar[first + b, order[k] - 1] = flow[k, BLOCK + b] * S_BASE_KVA


@compiled(inner=True)
def _store_block(first, last, order, r, ratio, v, l, v_pu, current_sq_pu, loss_kw):
    """Write what has been found of the rows from ``first`` to ``last``, as ``_load_block`` reads them."""
    loss = np.zeros(BLOCK)  # added up in float64 whatever the precision, as one row alone does
    for tile in range(0, BLOCK, TILE):
        for k in range(order.shape[0]):
            i = order[k]
            for b in range(tile, tile + TILE):
                v_pu[min(first + b, last), i] = v[k, b]
        for k in range(1, order.shape[0]):
            i = order[k]
            for b in range(tile, tile + TILE):
                current_sq_pu[min(first + b, last), i - 1] = l[k, b]
    for k in range(1, order.shape[0]):
        for b in range(BLOCK):
            loss[b] += r[k] * l[k, b]
    for row in range(first, last + 1):
        for i in range(v_pu.shape[1]):
            v_pu[row, i] = np.sqrt(v_pu[row, i])
        for k in range(ratio.shape[0]):
            v_pu[row, order[k]] *= ratio[k]
        loss_kw[row] = loss[row - first] * S_BASE_KVA


@compiled(inner=True)
def _add_shunts(shunt_g, shunt_b, flow, v, before):
    """Add the power of shunts at the voltages of the last sweep to the flows, and keep these voltages."""
    for k in range(shunt_g.shape[0]):
        for b in range(BLOCK):
            flow[k, b] += shunt_g[k] * v[k, b]
            flow[k, BLOCK + b] -= shunt_b[k] * v[k, b]
            before[k, b] = v[k, b]


@compiled(inner=True)
def _sweep(parent, r, x, shunt_g, shunt_b, load, flow, v, l, before, live, off, collapsed, v_up):
    """One sweep of a block of rows; per row the residual in ``off`` and whether a voltage is no longer positive.

    ``v_up`` is a scratch row for the voltages above: to read one row of an array while another row of it is written
    takes a check of overlap in every loop.
    """
    n = parent.shape[0]
    for k in range(n):
        r_k, x_k = r[k], x[k]
        for b in range(BLOCK):
            flow[k, b] = load[k, b] + r_k * l[k, b]
        for b in range(BLOCK):
            flow[k, BLOCK + b] = load[k, BLOCK + b] + x_k * l[k, b]
    _add_shunts(shunt_g, shunt_b, flow, v, before)
    for k in range(n - 1, 0, -1):
        i = parent[k]
        for b in range(2 * BLOCK):
            flow[i, b] += flow[k, b]
    for b in range(BLOCK):
        off[b] = 0.0
        collapsed[b] = 0.0
        v_up[b] = v[0, b]
    for k in range(1, n):
        i = parent[k]
        r_k, x_k = r[k], x[k]
        z_max, z_sq = max(r_k, x_k), r_k * r_k + x_k * x_k
        if i != k - 1:
            for b in range(BLOCK):
                v_up[b] = v[i, b]
        for b in range(BLOCK):
            v_i, p, q = v_up[b], flow[k, b], flow[k, BLOCK + b]
            l_new = (p * p + q * q) / v_i
            v_j = v_i - 2.0 * (r_k * p + x_k * q) + z_sq * l_new
            collapsed[b] = collapsed[b] if (v_j > V_SQ_FLOOR) & (v_j < V_SQ_CEILING) else 1.0  # no branch: a vector
            change = abs(l_new - l[k, b]) * z_max
            off[b] = change if change > off[b] else off[b]
            l[k, b] = l_new if live[b] > 0.0 else l[k, b]
            v[k, b] = v_j if live[b] > 0.0 else v[k, b]
            v_up[b] = v_j
    for k in range(shunt_g.shape[0]):
        size = max(abs(shunt_g[k]), abs(shunt_b[k]))
        for b in range(BLOCK):
            off[b] = max(off[b], abs(v[k, b] - before[k, b]) * size)


@compiled(nogil=True)
def distflow_blocks(
    order, parent, r, x, shunt_g, shunt_b, ratio, p_kw, q_kvar, v0_pu, warm, tolerance, max_sweeps, out
):
    """Solve all rows in blocks; return the number of rows that did not settle within BLOCK_SWEEPS.

    Their iterations are then NOT_IN_BLOCKS.
    """
    v_pu, p_branch_kw, q_branch_kvar, current_sq_pu, loss_kw, ok, iterations, residual_kva = out
    n_row, n = p_kw.shape
    powers, work = np.empty((2, n, 2 * BLOCK), p_kw.dtype), np.empty((2, n, BLOCK), p_kw.dtype)
    load, flow, v, l = powers[0], powers[1], work[0], work[1]
    rows = np.empty((4, BLOCK), p_kw.dtype)
    live, off, v_up, collapsed = rows[0], rows[1], rows[2], rows[3]
    before = np.empty((shunt_g.shape[0], BLOCK), p_kw.dtype)
    finite, settled = np.empty(BLOCK, np.bool_), np.empty(BLOCK, np.bool_)
    most = min(BLOCK_SWEEPS, max_sweeps)
    for first in range(0, n_row, BLOCK):
        left = count = min(BLOCK, n_row - first)
        last = first + count - 1
        _load_block(first, last, order, p_kw, q_kvar, v0_pu, warm, shunt_g.shape[0], load, v, l, finite)
        live[:] = 1.0
        iterations[first : last + 1] = NOT_IN_BLOCKS
        for sweep in range(1, most + 1):
            _sweep(parent, r, x, shunt_g, shunt_b, load, flow, v, l, before, live, off, collapsed, v_up)
            for b in range(BLOCK):  # columns without a row of their own do as the last row does
                gone = collapsed[b] > 0.0 or not finite[b]
                settled[b] = live[b] > 0.0 and not gone and off[b] <= tolerance
                if live[b] > 0.0 and (settled[b] or gone):
                    live[b] = 0.0
                    left -= b < count
                if settled[b] and b < count:
                    ok[first + b] = True
                    iterations[first + b] = sweep
                    residual_kva[first + b] = off[b] * S_BASE_KVA
            if p_branch_kw.shape[0] > 0:
                _store_flows(first, settled[:count], order, flow, p_branch_kw, q_branch_kvar)
            if left == 0:
                break
        _store_block(first, last, order, r, ratio, v, l, v_pu, current_sq_pu, loss_kw)
    unsettled = 0
    for row in range(n_row):
        unsettled += iterations[row] == NOT_IN_BLOCKS
    return unsettled
