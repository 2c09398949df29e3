"""Compiled DistFlow sweeps over buses in depth-first order, for NumPy arrays.

There are two forms of the same arithmetic: ``_row`` for a single feeder, and ``compiled_blocks`` for many, whose
innermost loops run over a block of rows and become vector instructions. In neither may the compiler reorder or fuse
floating-point operations, and the figures of a row are those of its last sweep. A feeder's solution is therefore
identical to the bit when solved alone, in any row of any batch and on any number of threads.

Scratch arrays are (n_bus, width) in depth-first order and per unit; ``l`` is squared current, ``v`` squared voltage.

A feeder's constants are ``order``, its depth-first order, and in that order ``parent``, ``r``, ``x``, ``shunt_g`` and
``shunt_b`` (draw and injection at 1 p.u.) and ``ratio`` (of the reported voltage to the referred one). The last three
have no rows if the feeder has no shunts, or no ratios other than 1, and are then skipped. A shunt's power is that of
the last sweep's voltage, and its change in the sweep is part of the residual.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.grid.per_unit import S_BASE_KVA
from dcgrid_env.powerflow.balanced.compiled_blocks import BLOCK_SWEEPS, NOT_IN_BLOCKS, PER_KVA
from dcgrid_env.powerflow.solution import (
    LINEAR_SWEEPS,
    LINEAR_TOLERANCE,
    LINEAR_TOLERANCE_32,
    V_SQ_CEILING,
    V_SQ_FLOOR,
)


@compiled(inner=True)
def _load(b, row, order, p_kw, q_kvar, v0_pu, scratch):
    """Put a row's loads into column b; whether all of them are finite."""
    p, q, _, _, v, _ = scratch
    check = 0.0
    for k in range(order.shape[0]):
        p[k, b] = p_kw[row, order[k]] * PER_KVA
        q[k, b] = q_kvar[row, order[k]] * PER_KVA
        v[k, b] = v0_pu[row] * v0_pu[row]
        check += 0.0 * p[k, b] + 0.0 * q[k, b]
    return check == 0.0


@compiled(inner=True)
def _start(b, row, order, warm, l):
    l[0, b] = 0.0
    for k in range(1, order.shape[0]):
        l[k, b] = warm[row, order[k] - 1] if warm.shape[0] > 0 else 0.0


@compiled(inner=True)
def _clear(scratch):
    """Write the figures of a row without a solution: no flow, and the lowest voltage except at the substation."""
    _, _, P, Q, v, l = scratch
    for k in range(1, v.shape[0]):
        P[k, 0] = Q[k, 0] = l[k, 0] = 0.0
        v[k, 0] = V_SQ_FLOOR


@compiled(inner=True)
def _add_shunts(shunt_g, shunt_b, scratch, before):
    """Add the power of shunts at the voltages of the last sweep to the flows, and keep these voltages."""
    _, _, P, Q, v, _ = scratch
    for k in range(shunt_g.shape[0]):
        for b in range(v.shape[1]):
            P[k, b] += shunt_g[k] * v[k, b]
            Q[k, b] -= shunt_b[k] * v[k, b]
            before[k, b] = v[k, b]


@compiled(inner=True)
def _add_change(shunt_g, shunt_b, v, before, off):
    """Raise the residual of each column to the largest change of a shunt's power in this sweep."""
    for k in range(shunt_g.shape[0]):
        size = max(abs(shunt_g[k]), abs(shunt_b[k]))
        for b in range(v.shape[1]):
            off[b] = max(off[b], abs(v[k, b] - before[k, b]) * size)


@compiled(inner=True)
def _store(b, row, order, r, ratio, scratch, sweeps, residual, converged, out):
    _, _, P, Q, v, l = scratch
    v_pu, p_branch_kw, q_branch_kvar, current_sq_pu, loss_kw, ok, iterations, residual_kva = out
    loss = 0.0
    v_pu[row, 0] = np.sqrt(v[0, b])
    for k in range(1, order.shape[0]):
        i = order[k]
        v_pu[row, i] = np.sqrt(v[k, b])
        if p_branch_kw.shape[0] > 0:
            p_branch_kw[row, i - 1] = P[k, b] * S_BASE_KVA
            q_branch_kvar[row, i - 1] = Q[k, b] * S_BASE_KVA
        current_sq_pu[row, i - 1] = l[k, b]
        loss += r[k] * l[k, b]
    for k in range(ratio.shape[0]):
        v_pu[row, order[k]] *= ratio[k]
    loss_kw[row] = loss * S_BASE_KVA
    ok[row] = converged
    iterations[row] = sweeps
    residual_kva[row] = residual * S_BASE_KVA


@compiled(inner=True)
def _row(parent, r, x, shunt_g, shunt_b, scratch, before, off, tolerance, max_sweeps):
    """Sweep one feeder (column 0 of the scratch) to the tolerance; (sweeps, residual), inf on a collapse."""
    p, q, P, Q, v, l = scratch
    n = parent.shape[0]
    residual = np.inf
    for sweep in range(1, max_sweeps + 1):
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
                return sweep, np.inf
            residual = max(residual, abs(l_new - l[k, 0]) * max(r[k], x[k]))
            l[k, 0] = l_new
            v[k, 0] = v_j
        if shunt_g.shape[0] > 0:
            off[0] = residual
            _add_change(shunt_g, shunt_b, v, before, off)
            residual = off[0]
        if residual <= tolerance:
            return sweep, residual
    return max_sweeps, residual


@compiled(nogil=True)
def distflow_rows(order, parent, r, x, shunt_g, shunt_b, ratio, p_kw, q_kvar, v0_pu, warm, tolerance, max_sweeps, out):
    """Solve each row of ``p_kw, q_kvar`` (row, bus) into the arrays of ``out``, which follow ``Solution``.

    ``warm`` (row, branch) holds squared currents to start from, or has no rows. A row that does not settle from there
    is solved again from no current, with ``max_sweeps``. Flows of branches whose arrays have no rows are left out.
    A row with positive iterations has settled already and is skipped. A row with NOT_IN_BLOCKS skips its start.
    Returns the number of rows without a solution.
    """
    n_row, n = p_kw.shape
    work = np.empty((6, n, 1), p_kw.dtype)
    scratch = (work[0], work[1], work[2], work[3], work[4], work[5])
    before = np.empty((shunt_g.shape[0], 1), p_kw.dtype)
    off = np.empty(1, p_kw.dtype)
    cold = warm[:0]
    failed = 0
    for row in range(n_row):
        if out[6][row] > 0:
            continue
        sweeps, residual = 0, np.inf
        finite = _load(0, row, order, p_kw, q_kvar, v0_pu, scratch)
        if finite and out[6][row] != NOT_IN_BLOCKS:
            _start(0, row, order, warm, scratch[5])
            most = min(BLOCK_SWEEPS, max_sweeps)
            sweeps, residual = _row(parent, r, x, shunt_g, shunt_b, scratch, before, off, tolerance, most)
        if finite and not residual <= tolerance:
            _load(0, row, order, p_kw, q_kvar, v0_pu, scratch)
            _start(0, row, order, cold, scratch[5])
            sweeps, residual = _row(parent, r, x, shunt_g, shunt_b, scratch, before, off, tolerance, max_sweeps)
        settled = residual <= tolerance
        failed += not settled
        if residual == np.inf:
            _clear(scratch)
        _store(0, row, order, r, ratio, scratch, sweeps, residual, settled, out)
    return failed


@compiled(nogil=True)
def lindistflow_rows(order, parent, r, x, shunt_g, shunt_b, ratio, p_kw, q_kvar, v0_pu, out):
    """Solve what ``distflow_rows`` solves without its loss terms: one pass, and more only for the shunts' power."""
    n_row, n = p_kw.shape
    work = np.empty((6, n, 1), p_kw.dtype)
    scratch = (work[0], work[1], work[2], work[3], work[4], work[5])
    p, q, P, Q, v, l = scratch
    before = np.empty((shunt_g.shape[0], 1), p_kw.dtype)
    off = np.empty(1, p_kw.dtype)
    tolerance = LINEAR_TOLERANCE if p_kw.itemsize == 8 else LINEAR_TOLERANCE_32
    failed = 0
    for row in range(n_row):
        settled = _load(0, row, order, p_kw, q_kvar, v0_pu, scratch)
        sweeps = 0
        off[0] = np.inf
        while settled and off[0] > tolerance and sweeps < LINEAR_SWEEPS:
            sweeps += 1
            off[0] = 0.0
            for k in range(n):
                P[k, 0] = p[k, 0]
                Q[k, 0] = q[k, 0]
                l[k, 0] = 0.0
            _add_shunts(shunt_g, shunt_b, scratch, before)
            for k in range(n - 1, 0, -1):
                P[parent[k], 0] += P[k, 0]
                Q[parent[k], 0] += Q[k, 0]
            for k in range(1, n):
                v[k, 0] = v[parent[k], 0] - 2.0 * (r[k] * P[k, 0] + x[k] * Q[k, 0])
                settled = settled and v[k, 0] > V_SQ_FLOOR and v[k, 0] < V_SQ_CEILING
            _add_change(shunt_g, shunt_b, v, before, off)
        settled = settled and off[0] <= tolerance
        failed += not settled
        if not settled:
            _clear(scratch)
        _store(0, row, order, r, ratio, scratch, max(sweeps, 1), off[0] if settled else np.inf, settled, out)
    return failed
