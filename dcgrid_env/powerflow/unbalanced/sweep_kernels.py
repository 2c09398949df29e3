"""The compiled backward and forward sweep over blocks of rows.

Voltages and currents are in flat arrays, with two lines of a block's rows for each node: the real and the imaginary
part. The phases of a bus are therefore contiguous in memory, and the innermost loops over rows become vector
instructions. The block's width is the length of the tuple ``wide``, a constant for the compiler: 1 for a single feeder,
``WIDE`` for many. The compiler may not reorder or fuse floating-point operations, so a row is identical to the bit in
both.
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.powerflow.unbalanced.plan import LINE, REGULATOR

U0, U1, U2, U3, U4, U5 = (np.uint64(i) for i in range(6))


@compiled(inner=True)
def shunt_currents(plan, wide, sign, V, J):
    """Set J to what the susceptances at each bus draw at V, times ``sign``, -1 for the conjugate."""
    W = np.uint64(len(wide))
    shunt = plan.shunt
    for k in range(plan.kind.shape[0]):
        o = plan.first[k] * U2 * W
        size = plan.first[k + 1] - plan.first[k]
        if size == U1:
            s0 = sign * shunt[k, 0]
            for b in range(W):
                J[o + b] = -(s0 * V[o + W + b])
                J[o + W + b] = s0 * V[o + b]
        elif size == U2:
            s0, s1, s2 = sign * shunt[k, 0], sign * shunt[k, 1], sign * shunt[k, 4]
            for b in range(W):
                J[o + b] = -(s0 * V[o + W + b] + s1 * V[o + U3 * W + b])
                J[o + W + b] = s0 * V[o + b] + s1 * V[o + U2 * W + b]
                J[o + U2 * W + b] = -(s1 * V[o + W + b] + s2 * V[o + U3 * W + b])
                J[o + U3 * W + b] = s1 * V[o + b] + s2 * V[o + U2 * W + b]
        else:
            s0, s1, s2, s3, s4, s5 = (
                sign * shunt[k, 0],
                sign * shunt[k, 1],
                sign * shunt[k, 2],
                sign * shunt[k, 4],
                sign * shunt[k, 5],
                sign * shunt[k, 8],
            )
            for b in range(W):
                r0, i0, r1, i1 = V[o + b], V[o + W + b], V[o + U2 * W + b], V[o + U3 * W + b]
                r2, i2 = V[o + U4 * W + b], V[o + U5 * W + b]
                J[o + b] = -(s0 * i0 + s1 * i1 + s2 * i2)
                J[o + W + b] = s0 * r0 + s1 * r1 + s2 * r2
                J[o + U2 * W + b] = -(s1 * i0 + s3 * i1 + s4 * i2)
                J[o + U3 * W + b] = s1 * r0 + s3 * r1 + s4 * r2
                J[o + U4 * W + b] = -(s2 * i0 + s4 * i1 + s5 * i2)
                J[o + U5 * W + b] = s2 * r0 + s4 * r1 + s5 * r2


@compiled(inline="always")
def power_share(law, k, inverse, line, power):
    """Return h of a leg with exponents at 1 / u, from the line below vmin and the power in these columns."""
    if inverse > law[k, 10]:
        return 1.0
    if inverse > law[k, 9]:
        return law[k, line] + law[k, line + 1] * inverse
    return inverse ** law[k, power] if inverse >= law[k, 8] else law[k, 8] * law[k, 8]


@compiled(inner=True)
def _power_admittance(law, k, wide, V, i, j, H):
    W = np.uint64(len(wide))
    for b in range(W):
        re = V[i + b] - V[j + b]
        im = V[i + W + b] - V[j + W + b]
        inverse = np.sqrt(law[k, 1] / (re * re + im * im))
        H[b] = power_share(law, k, inverse, 11, 15)
        H[W + b] = power_share(law, k, inverse, 13, 16)


@compiled(inline="always")
def leg_admittance(law, k, has_exponents, wide, V, i, j, H):
    """Set H to h_p and h_q of a leg between the rows i and j of V: see ``grid.three_phase_legs``."""
    if has_exponents:
        _power_admittance(law, k, wide, V, i, j, H)
    else:
        _share_admittance(law, k, wide, V, i, j, H)


@compiled(inline="always")
def _share_admittance(law, k, wide, V, i, j, H):
    W = np.uint64(len(wide))
    rated_sq, z_p, i_p, c_p = law[k, 1], law[k, 2], law[k, 3], law[k, 4]
    z_q, i_q, c_q = law[k, 5], law[k, 6], law[k, 7]
    floor, low = law[k, 8], law[k, 9]
    n_low = 0
    for b in range(W):
        re = V[i + b] - V[j + b]
        im = V[i + W + b] - V[j + W + b]
        inverse = np.sqrt(rated_sq / (re * re + im * im))  # 1 / u
        n_low += inverse > low
        u = inverse if inverse > floor else floor
        H[b] = z_p + u * (i_p + u * c_p)
        H[W + b] = z_q + u * (i_q + u * c_q)
    if n_low:
        for b in range(W):
            re = V[i + b] - V[j + b]
            im = V[i + W + b] - V[j + W + b]
            inverse = np.sqrt(rated_sq / (re * re + im * im))
            if inverse > law[k, 10]:
                H[b] = H[W + b] = 1.0
            elif inverse > low:
                H[b] = law[k, 11] + law[k, 12] * inverse
                H[W + b] = law[k, 13] + law[k, 14] * inverse


@compiled(inner=True)
def load_currents(plan, wide, V, P, Q, H, J):
    """Add to J what the loads' legs draw at V; P and Q hold their rows in the plan's order, scaled by the law's."""
    W = np.uint64(len(wide))
    ground = np.uint64(plan.up.shape[0])
    for k in range(plan.leg_ends.shape[0]):
        i = plan.leg_ends[k, 0] * U2 * W
        j = plan.leg_ends[k, 1] * U2 * W
        offset = np.uint64(k) * W
        if plan.leg_is_z[k]:
            for b in range(U2 * W):
                H[b] = 1.0
        else:
            leg_admittance(plan.leg_law, k, plan.leg_has_exponents[k], wide, V, i, j, H)
        if plan.leg_ends[k, 1] == ground:
            for b in range(W):
                p, q = P[offset + b] * H[b], Q[offset + b] * H[W + b]
                J[i + b] += p * V[i + b] + q * V[i + W + b]
                J[i + W + b] += p * V[i + W + b] - q * V[i + b]
        else:
            for b in range(W):
                p, q = P[offset + b] * H[b], Q[offset + b] * H[W + b]
                re = V[i + b] - V[j + b]
                im = V[i + W + b] - V[j + W + b]
                H[b] = p * re + q * im
                H[W + b] = p * im - q * re
            for b in range(U2 * W):
                J[i + b] += H[b]
                J[j + b] -= H[b]


@compiled(inner=True)
def device_currents(nodes, count, wide, V, P, Q, J):
    """Add to J what devices draw at V, a constant power at each of the first ``count`` nodes of the list."""
    W = np.uint64(len(wide))
    for k in range(count):
        i = nodes[k] * U2 * W
        offset = np.uint64(k) * W
        for b in range(W):
            re, im = V[i + b], V[i + W + b]
            inverse = 1.0 / (re * re + im * im)
            p, q = P[offset + b] * inverse, Q[offset + b] * inverse
            J[i + b] += p * re + q * im
            J[i + W + b] += p * im - q * re


@compiled(inner=True)
def capacitor_currents(plan, wide, V, on, J):
    """Add to J what the capacitors draw at V; ``on`` has a row for each bank."""
    W = np.uint64(len(wide))
    ground = np.uint64(plan.up.shape[0])
    for k in range(plan.capacitor_b.shape[0]):
        i = plan.capacitor_ends[k, 0] * U2 * W
        j = plan.capacitor_ends[k, 1] * U2 * W
        offset = plan.capacitor_row[k] * W
        b_pu = plan.capacitor_b[k]
        for b in range(W):
            re = V[i + b] - V[j + b]
            im = V[i + W + b] - V[j + W + b]
            J[i + b] -= b_pu * on[offset + b] * im
            J[i + W + b] += b_pu * on[offset + b] * re
            if plan.capacitor_ends[k, 1] != ground:
                J[j + b] += b_pu * on[offset + b] * im
                J[j + W + b] -= b_pu * on[offset + b] * re


@compiled(inner=True)
def add_up(plan, wide, ratio, J):
    """Backward: add the currents of each bus to those of the bus that feeds it, I_n = A^T I_m."""
    W = np.uint64(len(wide))
    for k in range(plan.kind.shape[0] - 1, 0, -1):
        n = plan.first[k]
        o = n * U2 * W
        size = plan.first[k + 1] - n
        if plan.kind[k] == LINE:
            if size == U3:
                u = plan.up[n] * U2 * W
                for b in range(np.uint64(6) * W):
                    J[u + b] += J[o + b]
            else:
                for i in range(size):
                    u = plan.up[n + i] * U2 * W
                    for b in range(U2 * W):
                        J[u + b] += J[o + i * U2 * W + b]
        elif plan.kind[k] == REGULATOR:
            for i in range(size):
                u = plan.up[n + i] * U2 * W
                t = plan.regulator[n + i] * W
                for b in range(W):
                    J[u + b] += ratio[t + b] * J[o + i * U2 * W + b]
                    J[u + W + b] += ratio[t + b] * J[o + i * U2 * W + W + b]
        else:
            for i in range(size):
                u = plan.up[n + i] * U2 * W
                for j in range(size):
                    a = plan.a[k, j * U3 + i]
                    for b in range(U2 * W):
                        J[u + b] += a * J[o + j * U2 * W + b]


@compiled(inner=True)
def go_down(plan, wide, sign, ratio, J, V, T, off):
    """Forward: V_m = A V_n - B I_m for each bus; ``sign`` times the reactance, -1 for the conjugate.

    ``off`` is raised to the largest squared change of a bus's voltages, per row; T has six rows of scratch.
    """
    W = np.uint64(len(wide))
    for b in range(W):
        off[b] = 0.0
    for k in range(plan.kind.shape[0]):
        n = plan.first[k]
        o = n * U2 * W
        size = plan.first[k + 1] - n
        if plan.kind[k] == LINE:
            _line(k, plan.z_re, plan.z_im, sign, plan.up, n, size, wide, J, V, T)
        else:
            for i in range(size):
                t = plan.regulator[n + i] * W
                offset = i * U2 * W
                u = plan.up[n + i] * U2 * W
                if plan.kind[k] == REGULATOR:
                    z_re, z_im = plan.z_re[k, i * U4], sign * plan.z_im[k, i * U4]
                    for b in range(W):
                        r = ratio[t + b]
                        re, im = r * J[o + offset + b], r * J[o + offset + W + b]
                        T[offset + b] = r * (V[u + b] - (z_re * re - z_im * im))
                        T[offset + W + b] = r * (V[u + W + b] - (z_re * im + z_im * re))
                else:
                    for b in range(U2 * W):
                        T[offset + b] = 0.0
                    for j in range(size):
                        a, z_re, z_im = plan.a[k, i * U3 + j], plan.z_re[k, i * U3 + j], sign * plan.z_im[k, i * U3 + j]
                        u = plan.up[n + j] * U2 * W
                        c = o + j * U2 * W
                        for b in range(W):
                            T[offset + b] += a * V[u + b] - (z_re * J[c + b] - z_im * J[c + W + b])
                            T[offset + W + b] += a * V[u + W + b] - (z_re * J[c + W + b] + z_im * J[c + b])
        _take_over(o, size, wide, T, V, off)


@compiled(inline="always")
def _take_over(o, size, wide, T, V, off):
    """Take a bus's new voltages from T into V, and raise ``off`` to their squared change, the sum over phases."""
    W = np.uint64(len(wide))
    if size == U3:
        for b in range(W):
            t0, t1, t2, t3 = T[b], T[W + b], T[U2 * W + b], T[U3 * W + b]
            t4, t5 = T[U4 * W + b], T[U5 * W + b]
            d0, d1, d2, d3 = t0 - V[o + b], t1 - V[o + W + b], t2 - V[o + U2 * W + b], t3 - V[o + U3 * W + b]
            d4, d5 = t4 - V[o + U4 * W + b], t5 - V[o + U5 * W + b]
            change = d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3 + d4 * d4 + d5 * d5
            off[b] = off[b] if off[b] >= change else change  # keeps a NaN of the last bus
            V[o + b], V[o + W + b], V[o + U2 * W + b], V[o + U3 * W + b] = t0, t1, t2, t3
            V[o + U4 * W + b], V[o + U5 * W + b] = t4, t5
    else:
        for i in range(size):
            offset = i * U2 * W
            for b in range(W):
                t0, t1 = T[offset + b], T[offset + W + b]
                d0, d1 = t0 - V[o + offset + b], t1 - V[o + offset + W + b]
                change = d0 * d0 + d1 * d1
                off[b] = off[b] if off[b] >= change else change
                V[o + offset + b], V[o + offset + W + b] = t0, t1


@compiled(inline="always")
def _line(k, z_re, z_im, sign, up, n, size, wide, J, V, T):
    """Set T to V_n - Z I of a line; rows of T first, and V after, as V's rows might else be each other's."""
    W = np.uint64(len(wide))
    o = n * U2 * W
    if size == U1:
        u = up[n] * U2 * W
        r0, x0 = z_re[k, 0], sign * z_im[k, 0]
        for b in range(W):
            T[b] = V[u + b] - (r0 * J[o + b] - x0 * J[o + W + b])
            T[W + b] = V[u + W + b] - (r0 * J[o + W + b] + x0 * J[o + b])
    elif size == U2:
        u, w = up[n] * U2 * W, up[n + U1] * U2 * W
        r0, r1, r2 = z_re[k, 0], z_re[k, 1], z_re[k, 4]
        x0, x1, x2 = sign * z_im[k, 0], sign * z_im[k, 1], sign * z_im[k, 4]
        for b in range(W):
            a, c, d, e = J[o + b], J[o + W + b], J[o + U2 * W + b], J[o + U3 * W + b]
            T[b] = V[u + b] - (r0 * a - x0 * c + r1 * d - x1 * e)
            T[W + b] = V[u + W + b] - (r0 * c + x0 * a + r1 * e + x1 * d)
            T[U2 * W + b] = V[w + b] - (r1 * a - x1 * c + r2 * d - x2 * e)
            T[U3 * W + b] = V[w + W + b] - (r1 * c + x1 * a + r2 * e + x2 * d)
    else:
        u = up[n] * U2 * W
        r0, r1, r2, r3, r4, r5 = z_re[k, 0], z_re[k, 1], z_re[k, 2], z_re[k, 4], z_re[k, 5], z_re[k, 8]
        x0, x1, x2 = sign * z_im[k, 0], sign * z_im[k, 1], sign * z_im[k, 2]
        x3, x4, x5 = sign * z_im[k, 4], sign * z_im[k, 5], sign * z_im[k, 8]
        for b in range(W):
            a, c, d, e = J[o + b], J[o + W + b], J[o + U2 * W + b], J[o + U3 * W + b]
            f, g = J[o + U4 * W + b], J[o + U5 * W + b]
            T[b] = V[u + b] - (r0 * a - x0 * c + r1 * d - x1 * e + r2 * f - x2 * g)
            T[W + b] = V[u + W + b] - (r0 * c + x0 * a + r1 * e + x1 * d + r2 * g + x2 * f)
            T[U2 * W + b] = V[u + U2 * W + b] - (r1 * a - x1 * c + r3 * d - x3 * e + r4 * f - x4 * g)
            T[U3 * W + b] = V[u + U3 * W + b] - (r1 * c + x1 * a + r3 * e + x3 * d + r4 * g + x4 * f)
            T[U4 * W + b] = V[u + U4 * W + b] - (r2 * a - x2 * c + r4 * d - x4 * e + r5 * f - x5 * g)
            T[U5 * W + b] = V[u + U5 * W + b] - (r2 * c + x2 * a + r4 * e + x4 * d + r5 * g + x5 * f)
