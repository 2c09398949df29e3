"""Compiled DistFlow sweeps of many feeders at once: the innermost loops run over a block of feeders, as vectors.

Arithmetic and conventions are those of ``distflow_kernels``, so results have the same bits in both. Scratch arrays are
(n_bus, WIDTH) in depth-first order and per unit, one column for each row of loads: ``p`` and ``q`` are loads, ``P`` and
``Q`` flows, ``l`` squared currents and ``v`` squared voltages. A block stays in the second-level cache.

A row of loads is stored in the sweep in which it settles. Its column takes part in the further sweeps of its block, but
these figures are not used. Sweeps thus have no conditions on columns.

The compiler turns an inner loop into vectors if the arrays that it writes do not overlap those that it reads, which it
checks at run time. It would check two rows of one array once for all buses, and always find an overlap. Therefore the
backward pass reads the index of its bus from an array, ``down``, and the forward pass copies the voltages above to
``v_up``. Loops of the backward pass write one row each, because checks of several take longer than a second loop.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.powerflow.solution import V_SQ_CEILING, V_SQ_FLOOR

TILE = 8  # rows that are stored side by side: a cache line of columns
BLOCK = 8 * TILE  # rows innermost; of 16, 32 and 64 the fastest on ieee123
WIDTH = BLOCK + TILE  # spare columns: at a power of two, the elements of a column would share few sets of the cache
FEW = 10  # up to this many rows one at a time beats a mostly empty block
MOST_IN_BLOCKS = 3000  # buses: a block is three times as fast there as one row at a time, and no faster at 10,000
BLOCK_SWEEPS = 30  # a row that needs more leaves its block, so that one near collapse does not hold up the rest
NOT_IN_BLOCKS = -1  # iterations of a row that its block left without a solution
PER_KVA = 1.0 / S_BASE_KVA


@compiled(inner=True)
def _tree(parent):
    """Return what the passes of a sweep go through: ``parent``, ``down``, ``child`` and ``sibling``.

    ``down`` lists all buses but the substation from the last to the first. ``child`` is the last child of a bus and
    ``sibling`` the next lower child of its parent, both 0 if there is none.
    """
    n = parent.shape[0]
    child, sibling = np.zeros(n, np.int64), np.zeros(n, np.int64)
    for k in range(1, n):
        sibling[k] = child[parent[k]]
        child[parent[k]] = k
    return parent, np.arange(n - 1, 0, -1), child, sibling


@compiled(inner=True)
def _load_block(first, last, order, p_kw, q_kvar, v0_pu, warm, n_shunts, p, q, v, l, live):
    """Put loads and start of the rows ``first`` to ``last`` into the columns; repeat ``last`` in the remaining columns.

    ``live`` is set to whether the load of the substation is finite. At other buses, one that is not ends in a collapse.
    """
    for b in range(BLOCK):
        row = min(first + b, last)
        for k in range(order.shape[0]):
            p[k, b] = p_kw[row, order[k]] * PER_KVA
        for k in range(order.shape[0]):
            q[k, b] = q_kvar[row, order[k]] * PER_KVA
        live[b] = 0.0 * p[0, b] + 0.0 * q[0, b] == 0.0
        v0 = v0_pu[row]
        v[0, b] = v0 * v0
        for k in range(n_shunts):  # the first sweep takes their power at this voltage
            v[k, b] = v0 * v0
    if warm.shape[0] == 0:
        l[:] = 0.0
    else:
        for b in range(BLOCK):
            row = min(first + b, last)
            l[0, b] = 0.0
            for k in range(1, order.shape[0]):
                l[k, b] = warm[row, order[k] - 1]


@compiled(inner=True)
def _store_columns(first, settled, order, values, unit, rows):
    """Write the settled columns of ``values`` times ``unit`` into ``rows`` (row, bus or branch)."""
    skipped = order.shape[0] - rows.shape[1]
    for tile in range(0, BLOCK, TILE):
        n_settled = 0
        for b in range(tile, tile + TILE):
            n_settled += settled[b]
        if n_settled == TILE:
            for k in range(skipped, order.shape[0]):
                i = order[k] - skipped
                for b in range(tile, tile + TILE):
                    rows[first + b, i] = values[k, b] * unit
        elif n_settled > 0:
            for b in range(tile, tile + TILE):
                if settled[b]:
                    for k in range(skipped, order.shape[0]):
                        rows[first + b, order[k] - skipped] = values[k, b] * unit


@compiled(inner=True)
def _store_settled(first, settled, order, r, ratio, P, Q, v, l, out):
    """Write what has been found of the rows that have settled in this sweep: the next one changes it."""
    v_pu, p_branch_kw, q_branch_kvar, current_sq_pu, loss_kw = out[0], out[1], out[2], out[3], out[4]
    _store_columns(first, settled, order, v, 1.0, v_pu)
    _store_columns(first, settled, order, l, 1.0, current_sq_pu)
    if p_branch_kw.shape[0] > 0:
        _store_columns(first, settled, order, P, S_BASE_KVA, p_branch_kw)
        _store_columns(first, settled, order, Q, S_BASE_KVA, q_branch_kvar)
    loss = np.zeros(BLOCK)  # added up in float64 whatever the precision, as one row alone does
    for k in range(1, order.shape[0]):
        for b in range(BLOCK):
            loss[b] += r[k] * l[k, b]
    for b in range(BLOCK):
        if settled[b]:
            row = first + b
            for i in range(v_pu.shape[1]):
                v_pu[row, i] = np.sqrt(v_pu[row, i])
            for k in range(ratio.shape[0]):
                v_pu[row, order[k]] *= ratio[k]
            loss_kw[row] = loss[b] * S_BASE_KVA


@compiled(inner=True)
def _backward(tree, r, x, p, q, P, Q, l):
    """Add up the flow into each bus: its load and losses, then the flows to its children from the last to the first."""
    _, down, child, sibling = tree
    for k in down:
        r_k, x_k, c = r[k], x[k], child[k]
        if c > 0:
            for b in range(BLOCK):
                P[k, b] = p[k, b] + r_k * l[k, b] + P[c, b]
            for b in range(BLOCK):
                Q[k, b] = q[k, b] + x_k * l[k, b] + Q[c, b]
            c = sibling[c]
        else:
            for b in range(BLOCK):
                P[k, b] = p[k, b] + r_k * l[k, b]
            for b in range(BLOCK):
                Q[k, b] = q[k, b] + x_k * l[k, b]
        while c > 0:
            for b in range(BLOCK):
                P[k, b] += P[c, b]
            for b in range(BLOCK):
                Q[k, b] += Q[c, b]
            c = sibling[c]


@compiled(inner=True)
def _backward_with_shunts(tree, r, x, shunt_g, shunt_b, p, q, P, Q, v, l, before):
    """Do as ``_backward``, with the shunt of a bus between its losses and its children.

    A shunt's power is that of the last sweep's voltage, which is kept in ``before``.
    """
    _, down, child, sibling = tree
    for k in down:
        for b in range(BLOCK):
            P[k, b] = p[k, b] + r[k] * l[k, b] + shunt_g[k] * v[k, b]
        for b in range(BLOCK):
            Q[k, b] = q[k, b] + x[k] * l[k, b] - shunt_b[k] * v[k, b]
        for b in range(BLOCK):
            before[k, b] = v[k, b]
        c = child[k]
        while c > 0:
            for b in range(BLOCK):
                P[k, b] += P[c, b]
            for b in range(BLOCK):
                Q[k, b] += Q[c, b]
            c = sibling[c]


@compiled(inner=True)
def _sweep(tree, r, x, shunt_g, shunt_b, p, q, P, Q, v, l, before, off, v_up):
    """One sweep of a block of rows; ``off`` is the residual of a row, infinite if a voltage is no longer positive."""
    parent, infinite = tree[0], r.dtype.type(np.inf)
    width = off.shape[0]  # BLOCK, but unknown to the compiler, which would unroll the loop over it and be slower
    if shunt_g.shape[0] > 0:
        _backward_with_shunts(tree, r, x, shunt_g, shunt_b, p, q, P, Q, v, l, before)
    else:
        _backward(tree, r, x, p, q, P, Q, l)
    for b in range(width):
        off[b] = 0.0
        v_up[b] = v[0, b]
    for k in range(1, parent.shape[0]):
        i = parent[k]
        r_k, x_k = r[k], x[k]
        z_max, z_sq = max(r_k, x_k), r_k * r_k + x_k * x_k
        if i != k - 1:
            for b in range(width):
                v_up[b] = v[i, b]
        for b in range(width):
            v_i, active, reactive = v_up[b], P[k, b], Q[k, b]
            l_new = (active * active + reactive * reactive) / v_i
            v_j = v_i - 2.0 * (r_k * active + x_k * reactive) + z_sq * l_new
            change = abs(l_new - l[k, b]) * z_max
            change = change if (v_j > V_SQ_FLOOR) & (v_j < V_SQ_CEILING) else infinite  # no branch: a vector
            off[b] = change if change > off[b] else off[b]
            l[k, b] = l_new
            v[k, b] = v_j
            v_up[b] = v_j
    for k in range(1, shunt_g.shape[0]):
        size = max(abs(shunt_g[k]), abs(shunt_b[k]))
        for b in range(width):
            change = abs(v[k, b] - before[k, b]) * size
            off[b] = change if change > off[b] else off[b]


@compiled(nogil=True)
def distflow_blocks(
    order, parent, r, x, shunt_g, shunt_b, ratio, p_kw, q_kvar, v0_pu, warm, tolerance, max_sweeps, out
):
    """Solve all rows in blocks; return the number of rows that did not settle within BLOCK_SWEEPS.

    Their iterations are then NOT_IN_BLOCKS.
    """
    ok, iterations, residual_kva = out[5], out[6], out[7]
    n_row, n = p_kw.shape
    tree, work, rows = _tree(parent), np.empty((6, n, WIDTH), p_kw.dtype), np.empty((2, BLOCK), p_kw.dtype)
    p, q, P, Q, v, l = work[0], work[1], work[2], work[3], work[4], work[5]
    off, v_up = rows[0], rows[1]
    before = np.empty((shunt_g.shape[0], BLOCK), p_kw.dtype)
    live, settled = np.empty(BLOCK, np.bool_), np.empty(BLOCK, np.bool_)
    unsettled = 0
    for first in range(0, n_row, BLOCK):
        count = min(BLOCK, n_row - first)
        last = first + count - 1
        _load_block(first, last, order, p_kw, q_kvar, v0_pu, warm, shunt_g.shape[0], p, q, v, l, live)
        live[count:] = False  # columns without a row of their own
        iterations[first : last + 1] = NOT_IN_BLOCKS
        left = live.sum()
        unsettled += count
        for sweep in range(1, min(BLOCK_SWEEPS, max_sweeps) + 1):
            if left == 0:
                break
            _sweep(tree, r, x, shunt_g, shunt_b, p, q, P, Q, v, l, before, off, v_up)
            n_settled = 0
            for b in range(BLOCK):
                settled[b] = live[b] and off[b] <= tolerance
                if live[b] and (settled[b] or off[b] == np.inf):
                    live[b] = False
                    left -= 1
                if settled[b]:
                    n_settled += 1
                    ok[first + b] = True
                    iterations[first + b] = sweep
                    residual_kva[first + b] = off[b] * S_BASE_KVA
            if n_settled > 0:
                _store_settled(first, settled, order, r, ratio, P, Q, v, l, out)
                unsettled -= n_settled
    return unsettled
