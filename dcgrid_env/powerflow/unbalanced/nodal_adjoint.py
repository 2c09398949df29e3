"""The parts of the derivative that differ with nodal equations: see ``sweep_adjoint`` and ``nodal``."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA
from dcgrid_env.powerflow.unbalanced.sweep_kernels import U1, U2, U3, U4


@compiled(inner=True)
def nodal_weights(first, count, plan, nodal, wide, solved, weights, converged, V, ratio, loss, G, K):
    """Add to G the weights of feeding currents, of the loss and of the source's power, all by the unknowns.

    It also puts the currents of the couplers into V, and the weight of the source's current into the first three
    nodes of K.
    """
    g_amperes, g_row = weights[2], weights[3]
    W, n_node = np.uint64(len(wide)), np.uint64(plan.up.shape[0])
    n_coupler = np.uint64(nodal.base_ratio.shape[0])
    for k in range(K.shape[0]):
        K[k] = 0.0
    for c in range(len(wide)):
        row, b = first + min(c, count - 1), np.uint64(c)
        for k in range(n_coupler):
            o = (n_node + U4 + k) * U2 * W + b
            is_good = converged[row]
            V[o] = solved[0][row, n_node * U2 + k] if is_good else 0.0
            V[o + W] = solved[0][row, n_node * U2 + n_coupler + k] if is_good else 0.0
        if not converged[row]:
            continue
        for i in range(n_node):
            o = i * U2 * W + b
            if g_amperes.shape[0] > 0:
                K[o] = g_amperes[row, i] * plan.ampere[i]
                K[o + W] = g_amperes[row, n_node + i] * plan.ampere[i]
            if i < U3 and g_row.shape[1] > 0:
                p, q = g_row[1, row] * PHASE_BASE_KVA, g_row[2, row] * PHASE_BASE_KVA
                K[o] += p * V[o] + q * V[o + W]
                K[o + W] += p * V[o + W] - q * V[o]
    if g_amperes.shape[0] > 0:
        _of_feeding_currents(nodal, wide, n_node, K, G)
    if g_row.shape[1] > 0:
        _of_losses(nodal, wide, n_node, n_coupler, V, ratio, loss, G)
    for i in range(U3):  # the source brings Y_s (V_0 - V)
        for j in range(U3):
            o, c, entry = j * U2 * W, i * U2 * W, i * U3 + j
            re, im = nodal.source_y[entry, 0], -nodal.source_y[entry, 1]
            for b in range(W):
                G[o + b] -= re * K[c + b] - im * K[c + W + b]
                G[o + W + b] -= re * K[c + W + b] + im * K[c + b]


@compiled(inner=True)
def _of_feeding_currents(nodal, wide, n_node, K, G):
    W = np.uint64(len(wide))
    for i in range(U3, n_node):
        o = i * U2 * W
        for entry in range(nodal.feed_start[i], nodal.feed_start[i + U1]):
            c, re, im = nodal.feed_column[entry] * U2 * W, nodal.feed[entry, 0], -nodal.feed[entry, 1]
            for b in range(W):
                G[c + b] += re * K[o + b] - im * K[o + W + b]
                G[c + W + b] += re * K[o + W + b] + im * K[o + b]
        if nodal.feed_coupler[i] >= 0:
            c, by = (n_node + U4 + np.uint64(nodal.feed_coupler[i])) * U2 * W, nodal.feed_sign[i]
            for b in range(U2 * W):
                G[c + b] += by * K[o + b]


@compiled(inner=True)
def _of_losses(nodal, wide, n_node, n_coupler, V, ratio, loss, G):
    W = np.uint64(len(wide))
    for i in range(n_node):
        o = i * U2 * W
        for entry in range(nodal.loss_start[i], nodal.loss_start[i + U1]):
            c, g = nodal.loss_column[entry] * U2 * W, 2.0 * nodal.loss[entry]
            for b in range(W):
                G[o + b] += loss[b] * g * V[c + b]
                G[o + W + b] += loss[b] * g * V[c + W + b]
    for k in range(n_coupler):
        c, r = (n_node + U4 + k) * U2 * W, 2.0 * nodal.coupler_z[k, 0]
        t = np.uint64(max(nodal.coupler_regulator[k], 0)) * W
        for b in range(W):
            tap = ratio[t + b] if nodal.coupler_regulator[k] >= 0 else 1.0
            G[c + b] += loss[b] * r * tap * tap * V[c + b]
            G[c + W + b] += loss[b] * r * tap * tap * V[c + W + b]
        for entry in range(nodal.mutual_start[k], nodal.mutual_start[k + U1]):
            o, r = (n_node + U4 + nodal.mutual_column[entry]) * U2 * W, 2.0 * nodal.mutual[entry]
            for b in range(W):
                G[c + b] += loss[b] * r * V[o + b]
                G[c + W + b] += loss[b] * r * V[o + W + b]


@compiled(inner=True)
def nodal_hand_over(first, count, plan, nodal, wide, V, Y, K, ratio, loss, out):
    """Derivatives by the source's voltage and by the ratios, from ibar (Y)."""
    d_source, d_ratio = out[2], out[3]
    W, n_node = np.uint64(len(wide)), np.uint64(plan.up.shape[0])
    for c in range(count):
        row, b = np.uint64(first + c), np.uint64(c)
        d_source[row] = 0.0
        for i in range(U3):
            o = i * U2 * W + b
            re, im = K[o] - Y[o], K[o + W] - Y[o + W]
            for j in range(U3):
                y_re, y_im = nodal.source_y[i * U3 + j, 0], -nodal.source_y[i * U3 + j, 1]
                d_source[row] += (y_re * re - y_im * im) * plan.source[j, 0]
                d_source[row] += (y_re * im + y_im * re) * plan.source[j, 1]
        for k in range(np.uint64(nodal.base_ratio.shape[0])):
            if nodal.coupler_regulator[k] < 0:
                continue
            r = ratio[np.uint64(nodal.coupler_regulator[k]) * W + b]
            z_re, z_im = nodal.coupler_z[k, 0], nodal.coupler_z[k, 1]
            f, g = nodal.coupler_ends[k, 0] * U2 * W + b, nodal.coupler_ends[k, 1] * U2 * W + b
            o = (n_node + U4 + k) * U2 * W + b
            i_re, i_im = V[o], V[o + W]
            to = (Y[f] - Y[g]) * i_re + (Y[f + W] - Y[g + W]) * i_im
            to += Y[o] * (V[f] - V[g] - 2.0 * r * (z_re * i_re - z_im * i_im))
            to += Y[o + W] * (V[f + W] - V[g + W] - 2.0 * r * (z_re * i_im + z_im * i_re))
            to += 2.0 * r * z_re * loss[b] * (i_re * i_re + i_im * i_im)
            d_ratio[row, nodal.coupler_regulator[k]] += to
