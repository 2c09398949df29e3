"""The compiled solution of the nodal equations over blocks of rows: see ``nodal`` and ``sweep_kernels``.

The currents of couplers follow the voltages of the nodes, of ground and of the ideal source. ``sign`` is -1 for the
conjugate equations, whose right-hand side for the couplers is in the same places of J.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.powerflow.unbalanced.sweep_kernels import U1, U2, U3, U4


@compiled(inner=True)
def clear_currents(nodal, wide, n_node, J):
    """Set J to zero at the nodes that a sweep solves."""
    W = np.uint64(len(wide))
    for k in range(nodal.unknown.shape[0]):
        if nodal.unknown[k] < n_node:
            o = nodal.unknown[k] * U2 * W
            for b in range(U2 * W):
                J[o + b] = 0.0


@compiled(inner=True)
def nodal_step(plan, nodal, wide, sign, ratio, J, V, X, off):
    """Solve M x = s - J for the unknowns that sweeps solve, and put them into V.

    ``off`` is raised to the largest squared change of a node's voltage. X is scratch, two rows for each unknown.
    """
    W, n_node = np.uint64(len(wide)), np.uint64(plan.up.shape[0])
    n_solved = np.uint64(nodal.row.shape[0])
    for k in range(n_solved):
        i = nodal.equation[k]
        o, c = nodal.row[k] * U2 * W, (i if i < n_node else i + U4) * U2 * W
        for b in range(U2 * W):
            X[o + b] = -J[c + b]
    for i in range(U3):
        o = nodal.place[i] * U2 * W
        for j in range(U3):
            _add_product(o, (n_node + U1 + j) * U2 * W, nodal.source_y, i * U3 + j, sign, wide, V, X)
    _tap_changes(nodal, wide, sign, n_node, ratio, V, X)
    for k in range(n_solved):
        o = nodal.row[k] * U2 * W
        for entry in range(nodal.lower_start[k], nodal.lower_start[k + U1]):
            _subtract_product(o, nodal.lower_column[entry] * U2 * W, nodal.lower, entry, sign, wide, X)
    for b in range(W):
        off[b] = 0.0
    for back in range(n_solved):
        k = n_solved - U1 - back
        o = nodal.row[k] * U2 * W
        for entry in range(nodal.upper_start[k], nodal.upper_start[k + U1]):
            _subtract_product(o, nodal.upper_column[entry] * U2 * W, nodal.upper, entry, sign, wide, X)
        _times(o, nodal.pivot, k, sign, wide, X)
        i = nodal.unknown[k]
        if i < n_node:
            c = i * U2 * W
            for b in range(W):
                d_re, d_im = X[o + b] - V[c + b], X[o + W + b] - V[c + W + b]
                change = d_re * d_re + d_im * d_im
                off[b] = off[b] if off[b] >= change else change  # keeps a NaN
                V[c + b], V[c + W + b] = X[o + b], X[o + W + b]
        else:
            c = (i + U4) * U2 * W
            for b in range(U2 * W):
                V[c + b] = X[o + b]


@compiled(inner=True)
def copy_column(nodal, wide, n_node, b, V, into):
    """Copy the unknowns that a sweep solves in column ``b`` from V to another array of its form."""
    W = np.uint64(len(wide))
    for k in range(nodal.unknown.shape[0]):
        i = nodal.unknown[k]
        o = (i if i < n_node else i + U4) * U2 * W + b
        into[o], into[o + W] = V[o], V[o + W]


@compiled(inner=True)
def nodal_rest(plan, nodal, wide, V, X):
    """Put the unknowns that sweeps do not solve into V, from those that they do."""
    W, n_node = np.uint64(len(wide)), np.uint64(plan.up.shape[0])
    for k in range(nodal.rest_row.shape[0]):
        o = nodal.rest_row[k] * U2 * W
        for b in range(U2 * W):
            X[o + b] = 0.0
    for k in range(nodal.row.shape[0]):
        i, o = nodal.unknown[k], nodal.row[k] * U2 * W
        c = (i if i < n_node else i + U4) * U2 * W
        for b in range(U2 * W):
            X[o + b] = V[c + b]
    for k in range(np.uint64(nodal.rest_row.shape[0])):
        i, o = nodal.rest_unknown[k], nodal.rest_row[k] * U2 * W
        for entry in range(nodal.rest_start[k], nodal.rest_start[k + U1]):
            _subtract_product(o, nodal.rest_column[entry] * U2 * W, nodal.rest, entry, 1.0, wide, X)
        _times(o, nodal.rest_pivot, k, 1.0, wide, X)
        c = (i if i < n_node else i + U4) * U2 * W
        for b in range(U2 * W):
            V[c + b] = X[o + b]


@compiled(inline="always")
def _times(o, values, entry, sign, wide, X):
    W = np.uint64(len(wide))
    re, im = values[entry, 0], sign * values[entry, 1]
    for b in range(W):
        x, y = X[o + b], X[o + W + b]
        X[o + b], X[o + W + b] = re * x - im * y, re * y + im * x


@compiled(inline="always")
def _subtract_product(o, c, values, entry, sign, wide, X):
    W = np.uint64(len(wide))
    re, im = values[entry, 0], sign * values[entry, 1]
    for b in range(W):
        x, y = X[c + b], X[c + W + b]
        X[o + b] -= re * x - im * y
        X[o + W + b] -= re * y + im * x


@compiled(inline="always")
def _add_product(o, c, values, entry, sign, wide, V, X):
    W = np.uint64(len(wide))
    re, im = values[entry, 0], sign * values[entry, 1]
    for b in range(W):
        x, y = V[c + b], V[c + W + b]
        X[o + b] += re * x - im * y
        X[o + W + b] += re * y + im * x


@compiled(inner=True)
def _tap_changes(nodal, wide, sign, n_node, ratio, V, X):
    """Take the difference of M at the present ratios from that at the base ones, times the last x, from X."""
    W = np.uint64(len(wide))
    for k in range(np.uint64(nodal.base_ratio.shape[0])):
        if nodal.coupler_regulator[k] < 0:
            continue
        t, base = np.uint64(nodal.coupler_regulator[k]) * W, nodal.base_ratio[k]
        z_re, z_im = nodal.coupler_z[k, 0], sign * nodal.coupler_z[k, 1]
        f, g, c = nodal.coupler_ends[k, 0], nodal.coupler_ends[k, 1], (n_node + U4 + k) * U2 * W
        at_f, at_row = nodal.place[f] * U2 * W, nodal.place[n_node + k] * U2 * W
        for b in range(W):
            r = ratio[t + b]
            one, two = r - base, r * r - base * base
            i_re, i_im = V[c + b], V[c + W + b]
            X[at_f + b] -= one * i_re
            X[at_f + W + b] -= one * i_im
            v_re = V[f * U2 * W + b] - V[g * U2 * W + b]
            v_im = V[f * U2 * W + W + b] - V[g * U2 * W + W + b]
            X[at_row + b] -= one * v_re - two * (z_re * i_re - z_im * i_im)
            X[at_row + W + b] -= one * v_im - two * (z_re * i_im + z_im * i_re)
            if g < n_node:
                at_g = nodal.place[g] * U2 * W
                X[at_g + b] += one * i_re
                X[at_g + W + b] += one * i_im


@compiled(inner=True)
def nodal_loss(plan, nodal, wide, V, ratio, loss):
    """Add to ``loss`` V^H G V and what the couplers' resistances lose, p.u."""
    W, n_node = np.uint64(len(wide)), np.uint64(plan.up.shape[0])
    for i in range(n_node):
        o = i * U2 * W
        for entry in range(nodal.loss_start[i], nodal.loss_start[i + U1]):
            c, g = nodal.loss_column[entry] * U2 * W, nodal.loss[entry]
            for b in range(W):
                loss[b] += g * (V[o + b] * V[c + b] + V[o + W + b] * V[c + W + b])
    for k in range(np.uint64(nodal.base_ratio.shape[0])):
        c, r = (n_node + U4 + k) * U2 * W, nodal.coupler_z[k, 0]
        t = np.uint64(max(nodal.coupler_regulator[k], 0)) * W
        for b in range(W):
            tap = ratio[t + b] if nodal.coupler_regulator[k] >= 0 else 1.0
            loss[b] += r * tap * tap * (V[c + b] * V[c + b] + V[c + W + b] * V[c + W + b])
        for entry in range(nodal.mutual_start[k], nodal.mutual_start[k + U1]):
            o, r = (n_node + U4 + nodal.mutual_column[entry]) * U2 * W, nodal.mutual[entry]
            for b in range(W):
                loss[b] += r * (V[o + b] * V[c + b] + V[o + W + b] * V[c + W + b])


@compiled(inner=True)
def feeding_currents(plan, nodal, wide, V, J):
    """Set J to the current that is brought to each node by what feeds it."""
    W, n_node = np.uint64(len(wide)), np.uint64(plan.up.shape[0])
    for i in range(n_node):
        o = i * U2 * W
        for b in range(U2 * W):
            J[o + b] = 0.0
        for entry in range(nodal.feed_start[i], nodal.feed_start[i + U1]):
            _add_product(o, nodal.feed_column[entry] * U2 * W, nodal.feed, entry, 1.0, wide, V, J)
        if nodal.feed_coupler[i] >= 0:
            c, by = (n_node + U4 + np.uint64(nodal.feed_coupler[i])) * U2 * W, nodal.feed_sign[i]
            for b in range(U2 * W):
                J[o + b] += by * V[c + b]
    for i in range(U3):
        o = i * U2 * W
        for j in range(U3):
            s, v = (n_node + U1 + j) * U2 * W, j * U2 * W
            re, im = nodal.source_y[i * U3 + j, 0], nodal.source_y[i * U3 + j, 1]
            for b in range(W):
                x, y = V[s + b] - V[v + b], V[s + W + b] - V[v + W + b]
                J[o + b] += re * x - im * y
                J[o + W + b] += re * y + im * x
