"""Compiled derivative of a solved DistFlow: the effect of each load on a weighted sum of the solution's figures.

The four equations of ``distflow`` are satisfied at the solution, so the derivative follows from them alone (the
implicit function theorem) and not from the sweeps. With w the squared voltage and a bar for the derivative of the
weighted sum with respect to a variable, branch k from i:

    lbar_k = weight of l + r Pbar_k + x Qbar_k + (r^2 + x^2) wbar_k
    Pbar_k = weight of P + Pbar_i - 2 r wbar_k + 2 P_k / w_i lbar_k             and dp_k = Pbar_k, dq_k = Qbar_k
    Qbar_k = weight of Q + Qbar_i - 2 x wbar_k + 2 Q_k / w_i lbar_k
    wbar_k = weight of w + sum over what k feeds: wbar_c - l_c / w_k lbar_c + g_k Pbar_k - b_k Qbar_k

The last two terms are those of a shunt, which draws g_k w_k and injects b_k w_k.
The sweeps go up the tree for w and down it for the rest, until lbar no longer changes. Blocks of rows are innermost, as
in ``compiled_blocks``.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.grid.per_unit import S_BASE_KVA

BLOCK = 32
"""Rows innermost; of 4, 8, 16 and 32 the fastest on ieee123."""
SWEEPS = 200
"""Most of them: enough for 1e-8 of the derivative up to 99.9 % of the load at which the named feeders collapse."""
TOLERANCE = {8: 1e-10, 4: 1e-5}
"""Largest last change of lbar times squared current, as a share of the largest wbar, by bytes a figure."""


@compiled(nogil=True)
def distflow_adjoint_rows(order, parent, r, x, shunt_g, shunt_b, ratio, solved, weights, converged, tolerance, out):
    """Fill ``out``: derivatives by p_kw and q_kvar (row, bus) and by v0_pu (row,) of sum(weights * solved).

    ``solved`` and ``weights`` contain v_pu (row, bus), p_branch_kw, q_branch_kvar and current_sq_pu (row, branch);
    ``weights`` also contains loss_kw (row,). The arguments before them are those of ``distflow_rows``. A row without a
    solution has no derivative and gets 0.
    """
    v_pu, p_branch, q_branch, current = solved
    g_v, g_p, g_q, g_l, g_loss = weights
    d_p, d_q, d_v0 = out
    n_row, n = v_pu.shape
    work = np.empty((12, n, BLOCK), v_pu.dtype)
    w, P, Q, l, gw, gP, gQ, gl, Pb, Qb, lb, wb = (
        work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8], work[9], work[10], work[11],
    )  # fmt: skip
    before = np.empty((shunt_g.shape[0], BLOCK), v_pu.dtype)
    off = np.empty(BLOCK, v_pu.dtype)
    size = np.empty(BLOCK, v_pu.dtype)
    for first in range(0, n_row, BLOCK):
        count = min(BLOCK, n_row - first)
        for b in range(BLOCK):
            row = first + min(b, count - 1)
            on = 1.0 if converged[row] else 0.0
            w[0, b] = v_pu[row, 0] * v_pu[row, 0]
            gw[0, b] = on * g_v[row, 0] / (2.0 * v_pu[row, 0])
            Pb[0, b] = Qb[0, b] = lb[0, b] = l[0, b] = 0.0
            for k in range(1, n):
                i = order[k]
                w[k, b] = v_pu[row, i] * v_pu[row, i]
                P[k, b] = p_branch[row, i - 1] / S_BASE_KVA
                Q[k, b] = q_branch[row, i - 1] / S_BASE_KVA
                l[k, b] = current[row, i - 1]
                gw[k, b] = on * g_v[row, i] / (2.0 * v_pu[row, i])
                gP[k, b] = on * g_p[row, i - 1] * S_BASE_KVA
                gQ[k, b] = on * g_q[row, i - 1] * S_BASE_KVA
                gl[k, b] = on * (g_l[row, i - 1] + g_loss[row] * S_BASE_KVA * r[k])
                lb[k, b] = 0.0
            for k in range(ratio.shape[0]):
                w[k, b] /= ratio[k] * ratio[k]
                gw[k, b] *= ratio[k] * ratio[k]
            for k in range(1, shunt_g.shape[0]):
                Pb[k, b] = Qb[k, b] = 0.0
        for _ in range(SWEEPS):
            for k in range(n):
                for b in range(BLOCK):
                    wb[k, b] = gw[k, b]
            for k in range(1, shunt_g.shape[0]):
                for b in range(BLOCK):
                    before[k, b] = shunt_g[k] * Pb[k, b] - shunt_b[k] * Qb[k, b]
                    wb[k, b] += before[k, b]
            for k in range(n - 1, 0, -1):
                i = parent[k]
                for b in range(BLOCK):
                    wb[i, b] += wb[k, b] - l[k, b] / w[i, b] * lb[k, b]
            for b in range(BLOCK):
                off[b] = 0.0
                size[b] = abs(wb[0, b])
            for k in range(1, n):
                i = parent[k]
                r_k = r[k]
                x_k = x[k]
                z_sq = r_k * r_k + x_k * x_k
                for b in range(BLOCK):
                    to_p = gP[k, b] + Pb[i, b] - 2.0 * r_k * wb[k, b]
                    to_q = gQ[k, b] + Qb[i, b] - 2.0 * x_k * wb[k, b]
                    by_p = 2.0 * P[k, b] / w[i, b]
                    by_q = 2.0 * Q[k, b] / w[i, b]
                    new = (gl[k, b] + r_k * to_p + x_k * to_q + z_sq * wb[k, b]) / (1.0 - r_k * by_p - x_k * by_q)
                    off[b] = max(off[b], abs(new - lb[k, b]) * l[k, b])
                    size[b] = max(size[b], abs(wb[k, b]))
                    lb[k, b] = new
                    Pb[k, b] = to_p + by_p * new
                    Qb[k, b] = to_q + by_q * new
            for k in range(1, shunt_g.shape[0]):
                for b in range(BLOCK):
                    change = shunt_g[k] * Pb[k, b] - shunt_b[k] * Qb[k, b] - before[k, b]
                    off[b] = max(off[b], abs(change))
            settled = True
            for b in range(BLOCK):
                settled = settled and off[b] <= tolerance * size[b]
            if settled:
                break
        for b in range(count):
            row = first + b
            d_p[row, 0] = d_q[row, 0] = 0.0
            for k in range(1, n):
                d_p[row, order[k]] = Pb[k, b] / S_BASE_KVA
                d_q[row, order[k]] = Qb[k, b] / S_BASE_KVA
            d_v0[row] = wb[0, b] * 2.0 * v_pu[row, 0]
