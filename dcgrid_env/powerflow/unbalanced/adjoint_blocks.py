"""The parts of the derivative of a block of rows: the legs' derivatives, the weights, and what is handed over."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA
from dcgrid_env.powerflow.unbalanced.plan import REGULATOR
from dcgrid_env.powerflow.unbalanced.row_blocks import PER_KVA
from dcgrid_env.powerflow.unbalanced.sweep_kernels import U2, U3, U4, leg_admittance, power_share

NO_VOLTAGE_SQ = 1e-24
"""Squared voltage that keeps the derivatives at a grounded conductor finite, p.u."""


@compiled(inner=True)
def leg_derivatives(plan, wide, V, P, Q, DP, DQ, N):
    """Set N to the derivatives of currents by voltages: all legs to ground of a node together, then each other leg.

    Four rows each: d re / d re, d re / d im, d im / d re, d im / d im. With g = p h_p and k = u h_p' p / |V|^2, and
    likewise for q, I = g_p V - j g_q V and d g_p = k_p Re(conj(V) dV).
    """
    W, n_node = np.uint64(len(wide)), np.uint64(plan.up.shape[0])
    for n in range(n_node):
        i, offset, m = n * U2 * W, n * W, n * U4 * W
        for b in range(W):
            re, im = V[i + b], V[i + W + b]
            inverse = 1.0 / max(re * re + im * im, NO_VOLTAGE_SQ)
            g_p, g_q = DP[offset + b] * inverse, DQ[offset + b] * inverse
            k_p, k_q = -2.0 * g_p * inverse, -2.0 * g_q * inverse
            to_re, to_im = k_p * re + k_q * im, k_p * im - k_q * re
            N[m + b], N[m + W + b] = g_p + to_re * re, g_q + to_re * im
            N[m + U2 * W + b], N[m + U3 * W + b] = to_im * re - g_q, g_p + to_im * im
    law = plan.leg_law
    for k in range(plan.leg_is_z.shape[0]):
        i, j = plan.leg_ends[k, 0] * U2 * W, plan.leg_ends[k, 1] * U2 * W
        is_grounded = plan.leg_ends[k, 1] == n_node
        m = (plan.leg_ends[k, 0] if is_grounded else n_node + np.uint64(k)) * U4 * W
        offset = np.uint64(k) * W
        for b in range(W):
            re, im = V[i + b] - V[j + b], V[i + W + b] - V[j + W + b]
            v_sq = re * re + im * im
            u = np.sqrt(law[k, 1] / v_sq)  # 1 / u
            if plan.leg_is_z[k] or u > law[k, 10]:
                h_p = h_q = 1.0
                s_p = s_q = 0.0
            elif u > law[k, 9]:
                h_p, h_q = law[k, 11] + law[k, 12] * u, law[k, 13] + law[k, 14] * u
                s_p, s_q = -law[k, 12] * u, -law[k, 14] * u
            elif plan.leg_has_exponents[k]:
                h_p, h_q = power_share(law, k, u, 11, 15), power_share(law, k, u, 13, 16)
                inside = 1.0 if u >= law[k, 8] else 0.0
                s_p, s_q = -inside * law[k, 15] * h_p, -inside * law[k, 16] * h_q
            else:
                c = max(u, law[k, 8])
                h_p, h_q = law[k, 2] + c * (law[k, 3] + c * law[k, 4]), law[k, 5] + c * (law[k, 6] + c * law[k, 7])
                inside = 1.0 if u >= law[k, 8] else 0.0
                s_p = -inside * u * (law[k, 3] + 2.0 * u * law[k, 4])
                s_q = -inside * u * (law[k, 6] + 2.0 * u * law[k, 7])
            p, q = P[offset + b], Q[offset + b]
            g_p, g_q, k_p, k_q = p * h_p, q * h_q, p * s_p / v_sq, q * s_q / v_sq
            to_re, to_im = k_p * re + k_q * im, k_p * im - k_q * re
            if not is_grounded:
                N[m + b] = N[m + W + b] = N[m + U2 * W + b] = N[m + U3 * W + b] = 0.0
            N[m + b] += g_p + to_re * re
            N[m + W + b] += g_q + to_re * im
            N[m + U2 * W + b] += to_im * re - g_q
            N[m + U3 * W + b] += g_p + to_im * im


@compiled(inner=True)
def legs_transposed(plan, wide, N, G, Y, X):
    """Add G and N^T Y to X."""
    W, n_node = np.uint64(len(wide)), np.uint64(plan.up.shape[0])
    for n in range(n_node):
        i, m = n * U2 * W, n * U4 * W
        for b in range(W):
            re, im = Y[i + b], Y[i + W + b]
            X[i + b] += G[i + b] + N[m + b] * re + N[m + U2 * W + b] * im
            X[i + W + b] += G[i + W + b] + N[m + W + b] * re + N[m + U3 * W + b] * im
    for k in range(plan.leg_is_z.shape[0]):
        if plan.leg_ends[k, 1] == n_node:
            continue
        i, j, m = plan.leg_ends[k, 0] * U2 * W, plan.leg_ends[k, 1] * U2 * W, (n_node + np.uint64(k)) * U4 * W
        for b in range(W):
            re, im = Y[i + b] - Y[j + b], Y[i + W + b] - Y[j + W + b]
            to_re = N[m + b] * re + N[m + U2 * W + b] * im
            to_im = N[m + W + b] * re + N[m + U3 * W + b] * im
            X[i + b] += to_re
            X[i + W + b] += to_im
            X[j + b] -= to_re
            X[j + W + b] -= to_im


@compiled(inner=True)
def load_weights(first, count, plan, wide, solved, weights, V, J, G, loss):
    """Put solutions into V and J and the weights of voltages into G; whether anything of currents is weighed."""
    volts, amperes = solved
    g_magnitude, g_volts, g_amperes, g_row = weights
    W, n_node = np.uint64(len(wide)), plan.up.shape[0]
    for k in range(G.shape[0]):
        G[k] = 0.0
    for n in range(n_node):
        o = np.uint64(n) * U2 * W
        for c in range(len(wide)):
            row, b = first + min(c, count - 1), np.uint64(c)
            re, im = volts[row, n], volts[row, n_node + n]
            V[o + b], V[o + W + b] = re, im
            J[o + b], J[o + W + b] = amperes[row, n] / plan.ampere[n], amperes[row, n_node + n] / plan.ampere[n]
            if g_magnitude.shape[0] > 0:
                to = g_magnitude[row, n] / np.sqrt(max(re * re + im * im, NO_VOLTAGE_SQ))
                G[o + b], G[o + W + b] = to * re, to * im
            if g_volts.shape[0] > 0:
                G[o + b] += g_volts[row, n]
                G[o + W + b] += g_volts[row, n_node + n]
    for c in range(len(wide)):
        loss[c] = 0.0
        if g_row.shape[1] > 0:
            row, b = first + min(c, count - 1), np.uint64(c)
            loss[c] = g_row[0, row] * PHASE_BASE_KVA
            for k in range(plan.core_g.shape[0]):
                i, j = plan.core_ends[k, 0] * U2 * W + b, plan.core_ends[k, 1] * U2 * W + b
                to = 2.0 * loss[c] * plan.core_g[k]
                re, im = to * (V[i] - V[j]), to * (V[i + W] - V[j + W])
                G[i] += re
                G[i + W] += im
                G[j] -= re
                G[j + W] -= im
            p, q = g_row[1, row] * PHASE_BASE_KVA, g_row[2, row] * PHASE_BASE_KVA
            for i in range(U3):
                o = i * U2 * W + b
                G[o] += p * J[o] - q * J[o + W]
                G[o + W] += p * J[o + W] + q * J[o]
    return g_amperes.shape[0] > 0 or g_row.shape[1] > 0


@compiled(inner=True)
def clear_inactive(first, count, plan, wide, converged, V, J, P, Q, DP, DQ, G, loss):
    """Set loads and weights to zero in rows without a solution."""
    W = np.uint64(len(wide))
    for c in range(len(wide)):
        if converged[first + min(c, count - 1)]:
            continue
        b = np.uint64(c)
        loss[c] = 0.0
        for n in range(np.uint64(plan.up.shape[0])):
            o = n * U2 * W + b
            V[o], V[o + W] = 1.0, float(n)  # no two the same, so that no leg is without voltage
            J[o], J[o + W], G[o], G[o + W] = 0.0, 0.0, 0.0, 0.0
            DP[n * W + b] = DQ[n * W + b] = 0.0
        for k in range(np.uint64(plan.leg_is_z.shape[0])):
            P[k * W + b] = Q[k * W + b] = 0.0


@compiled(inner=True)
def current_weights(first, count, plan, wide, weights, converged, V, J, ratio, loss, K):
    """Set K to the weights of the branches' currents, taken down the tree: K_m = weight + A K_n."""
    g_amperes, g_row = weights[2], weights[3]
    W, n_node = np.uint64(len(wide)), plan.up.shape[0]
    for k in range(K.shape[0]):
        K[k] = 0.0
    for k in range(plan.kind.shape[0]):
        n, size = plan.first[k], plan.first[k + 1] - plan.first[k]
        for i in range(size):
            o, t = (n + i) * U2 * W, plan.regulator[n + i] * W
            for j in range(size):
                a, r, c = plan.a[k, i * U3 + j], plan.z_re[k, i * U3 + j], (n + j) * U2 * W
                u = plan.up[n + j] * U2 * W
                for b in range(W):
                    tap = ratio[t + b] if plan.kind[k] == REGULATOR else 1.0
                    lost = 2.0 * r * tap * tap * loss[b] if k > 0 else 0.0
                    K[o + b] += a * tap * K[u + b] + lost * J[c + b]
                    K[o + W + b] += a * tap * K[u + W + b] + lost * J[c + W + b]
            for c in range(len(wide)):
                row, b = first + min(c, count - 1), np.uint64(c)
                if not converged[row]:
                    continue
                if g_amperes.shape[0] > 0:
                    K[o + b] += g_amperes[row, n + i] * plan.ampere[n + i]
                    K[o + W + b] += g_amperes[row, np.uint64(n_node) + n + i] * plan.ampere[n + i]
                if k == 0 and g_row.shape[1] > 0:
                    p, q = g_row[1, row] * PHASE_BASE_KVA, g_row[2, row] * PHASE_BASE_KVA
                    K[o + b] += p * V[o + b] + q * V[o + W + b]
                    K[o + W + b] += p * V[o + W + b] - q * V[o + b]


@compiled(inner=True)
def hand_over(first, count, plan, wide, V, J, X, Y, ratio, loss, H, out):
    """Turn vbar (X) and ibar (Y) into the derivatives by the inputs."""
    d_p, d_q, d_source, d_ratio, d_on = out
    W, n_node, n_leg = np.uint64(len(wide)), np.uint64(plan.up.shape[0]), plan.leg_is_z.shape[0]
    n_row, begin = np.uint64(count), np.uint64(first)
    for k in range(n_leg):
        i, j, leg = plan.leg_ends[k, 0] * U2 * W, plan.leg_ends[k, 1] * U2 * W, plan.leg_order[k]
        if plan.leg_is_z[k]:
            for b in range(U2 * W):
                H[b] = 1.0
        else:
            leg_admittance(plan.leg_law, k, plan.leg_has_exponents[k], wide, V, i, j, H)
        scale = plan.leg_law[k, 0]
        for b in range(n_row):
            re, im = V[i + b] - V[j + b], V[i + W + b] - V[j + W + b]
            to_re, to_im = scale * (Y[i + b] - Y[j + b]), scale * (Y[i + W + b] - Y[j + W + b])
            d_p[begin + b, leg] = H[b] * (to_re * re + to_im * im)
            d_q[begin + b, leg] = H[W + b] * (to_re * im - to_im * re)
    for n in range(n_node):
        o = n * U2 * W
        for b in range(n_row):
            re, im = V[o + b], V[o + W + b]
            scale = PER_KVA / max(re * re + im * im, NO_VOLTAGE_SQ)
            d_p[begin + b, np.uint64(n_leg) + n] = scale * (Y[o + b] * re + Y[o + W + b] * im)
            d_q[begin + b, np.uint64(n_leg) + n] = scale * (Y[o + b] * im - Y[o + W + b] * re)
    for b in range(n_row):
        row = begin + b
        d_source[row] = 0.0
        for i in range(3):
            o = np.uint64(i) * U2 * W + b
            d_source[row] += X[o] * plan.source[i, 0] + X[o + W] * plan.source[i, 1]
        for k in range(d_ratio.shape[1]):
            d_ratio[row, k] = 0.0
        for k in range(d_on.shape[1]):
            d_on[row, k] = 0.0
        for k in range(plan.capacitor_b.shape[0]):
            i, j = plan.capacitor_ends[k, 0] * U2 * W + b, plan.capacitor_ends[k, 1] * U2 * W + b
            re, im = V[i] - V[j], V[i + W] - V[j + W]
            moved = (Y[i + W] - Y[j + W]) * re - (Y[i] - Y[j]) * im
            d_on[row, plan.capacitor_row[k]] += plan.capacitor_b[k] * moved
        for k in range(plan.kind.shape[0]):
            if plan.kind[k] == REGULATOR:
                _by_ratio(k, row, b, plan, W, V, J, X, Y, ratio, loss, d_ratio)


@compiled(inner=True)
def _by_ratio(k, row, b, plan, W, V, J, X, Y, ratio, loss, d_ratio):
    n, size = plan.first[k], plan.first[k + 1] - plan.first[k]
    for i in range(size):
        o, u = (n + i) * U2 * W + b, plan.up[n + i] * U2 * W + b
        ratio_row = plan.regulator[n + i]
        r, z_re, z_im = ratio[ratio_row * W + b], plan.z_re[k, i * U4], plan.z_im[k, i * U4]
        re, im = J[o], J[o + W]
        to = X[o] * (V[u] - 2.0 * r * (z_re * re - z_im * im)) + X[o + W] * (
            V[u + W] - 2.0 * r * (z_re * im + z_im * re)
        )
        to += Y[u] * re + Y[u + W] * im
        d_ratio[row, ratio_row] += to + 2.0 * r * z_re * loss[b] * (re * re + im * im)
