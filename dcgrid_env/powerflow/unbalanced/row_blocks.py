"""A block of rows: loading its inputs, its sweep, and writing its results."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA
from dcgrid_env.powerflow.solution import V_SQ_CEILING, V_SQ_FLOOR
from dcgrid_env.powerflow.unbalanced.nodal_kernels import (
    clear_currents,
    feeding_currents,
    nodal_loss,
    nodal_rest,
    nodal_step,
)
from dcgrid_env.powerflow.unbalanced.plan import REGULATOR
from dcgrid_env.powerflow.unbalanced.sweep_kernels import (
    U1,
    U2,
    U3,
    U4,
    add_up,
    capacitor_currents,
    device_currents,
    go_down,
    load_currents,
    shunt_currents,
)

PER_KVA = 1.0 / PHASE_BASE_KVA


@compiled(inner=True)
def workspace(plan, nodal, wide, inputs):
    """Rows for V, J, loads P and Q, devices P and Q, H, ratio, on, T and off, of the block's width each.

    Each has as many rows as what is put into it has columns: ``ratio`` one a regulator, and one where there is none;
    ``on`` one a bank. V and J also have the currents of the couplers of ``nodal``, which is None for radial feeders.
    """
    n, W, scratch = plan.up.shape[0] + 4, len(wide), 6
    if nodal is not None:
        n += nodal.base_ratio.shape[0]
        scratch += 2 * nodal.place.shape[0]
    n_leg, n_ratio, n_bank = plan.leg_is_z.shape[0], max(inputs[3].shape[1], 1), inputs[4].shape[1]
    V = np.zeros(2 * n * W)
    J = np.zeros(2 * n * W)
    P, Q = np.zeros(n_leg * W), np.zeros(n_leg * W)
    DP, DQ = np.zeros(n * W), np.zeros(n * W)
    ratio, on = np.ones(n_ratio * W), np.ones(n_bank * W)
    return V, J, P, Q, DP, DQ, np.zeros(2 * W), ratio, on, np.zeros(scratch * W), np.zeros(W)


@compiled(inner=True)
def active_devices(p_kw, q_kvar, first, count, n_leg, drawn, nodes):
    """List the nodes at which any of these rows has a device that draws; their number. ``drawn`` is scratch."""
    n_node, skip = np.uint64(nodes.shape[0]), np.uint64(n_leg)
    for n in range(n_node):
        drawn[n] = 0.0
    for row in range(first, first + count):
        for n in range(n_node):
            drawn[n] += abs(p_kw[row, skip + n]) + abs(q_kvar[row, skip + n])
    n_device = 0
    for n in range(n_node):
        if drawn[n] != 0.0:
            nodes[n_device] = n
            n_device += 1
    return n_device


@compiled(inner=True)
def load_row(b, row, plan, wide, inputs, nodes, n_device, work):
    """Put a row's inputs into column b, and the ideal source's voltage; whether all of them are finite."""
    p_kw, q_kvar, source_pu, ratios, states = inputs
    V, _, P, Q, DP, DQ, _, ratio, on, _, _ = work
    W = np.uint64(len(wide))
    b = np.uint64(b)
    n_leg, n_node = plan.leg_order.shape[0], np.uint64(plan.up.shape[0])
    check = 0.0
    for k in range(n_leg):
        leg = plan.leg_order[k]
        entry = np.uint64(k) * W + b
        P[entry] = p_kw[row, leg] * plan.leg_law[k, 0]
        Q[entry] = q_kvar[row, leg] * plan.leg_law[k, 0]
        check += 0.0 * P[entry] + 0.0 * Q[entry]
    for k in range(n_device):
        entry = np.uint64(k) * W + b
        DP[entry] = p_kw[row, n_leg + nodes[k]] * PER_KVA
        DQ[entry] = q_kvar[row, n_leg + nodes[k]] * PER_KVA
        check += 0.0 * DP[entry] + 0.0 * DQ[entry]
    for k in range(ratios.shape[1]):
        ratio[np.uint64(k) * W + b] = ratios[row, k]
    for k in range(states.shape[1]):
        on[np.uint64(k) * W + b] = states[row, k]
    for k in range(3):
        entry = (n_node + U1 + np.uint64(k)) * U2 * W + b
        V[entry] = source_pu[row] * plan.source[k, 0]
        V[entry + W] = source_pu[row] * plan.source[k, 1]
    return check == 0.0


@compiled(inner=True)
def start_row(b, row, plan, nodal, wide, start, work):
    """Put what to start from into column b, where there is any: a row of zeros is none."""
    V = work[0]
    W = np.uint64(len(wide))
    n_node = plan.up.shape[0]
    if start.shape[0] == 0 or start[row, 0] == 0.0:
        return
    for n in range(n_node):
        entry = np.uint64(n) * U2 * W + np.uint64(b)
        V[entry] = start[row, n]
        V[entry + W] = start[row, n_node + n]
    if nodal is not None:
        n_coupler = nodal.base_ratio.shape[0]
        for k in range(n_coupler):
            entry = np.uint64(n_node + 4 + k) * U2 * W + np.uint64(b)
            V[entry] = start[row, 2 * n_node + k]
            V[entry + W] = start[row, 2 * n_node + n_coupler + k]


@compiled(inner=True)
def begin(plan, nodal, wide, work):
    """Voltages without any load: the cold start of a block."""
    V, J, _, _, _, _, _, ratio, _, T, off = work
    for k in range(J.shape[0]):
        J[k] = 0.0
    if nodal is None:
        go_down(plan, wide, 1.0, ratio, J, V, T, off)
    else:
        ideal = 2 * (plan.up.shape[0] + 1) * len(wide)
        for k in range(V.shape[0]):  # apart from the ideal source: ratios start from nothing, whatever was here before
            if k < ideal or k >= ideal + 6 * len(wide):
                V[k] = 0.0
        nodal_step(plan, nodal, wide, 1.0, ratio, J, V, T, off)


@compiled(inner=True)
def core_currents(plan, wide, sign, V, J):
    """Add to J what the transformers' cores draw at V; ``sign`` times the susceptance, -1 for the conjugate."""
    W = np.uint64(len(wide))
    for k in range(plan.core_g.shape[0]):
        i = plan.core_ends[k, 0] * U2 * W
        j = plan.core_ends[k, 1] * U2 * W
        g, s = plan.core_g[k], sign * plan.core_b[k]
        for b in range(W):
            re = V[i + b] - V[j + b]
            im = V[i + W + b] - V[j + W + b]
            J[i + b] += g * re - s * im
            J[i + W + b] += g * im + s * re
            J[j + b] -= g * re - s * im
            J[j + W + b] -= g * im + s * re


@compiled(inner=True)
def sweep_block(plan, nodal, wide, nodes, n_device, work):
    """Do one backward and forward sweep; the last row then contains the squared change of the voltages.

    With ``nodal`` the nodal equations take the place of the sweep.
    """
    V, J, P, Q, DP, DQ, H, ratio, on, T, off = work
    if nodal is None:
        shunt_currents(plan, wide, 1.0, V, J)
    else:
        clear_currents(nodal, wide, np.uint64(plan.up.shape[0]), J)
    load_currents(plan, wide, V, P, Q, H, J)
    device_currents(nodes, n_device, wide, V, DP, DQ, J)
    capacitor_currents(plan, wide, V, on, J)
    core_currents(plan, wide, 1.0, V, J)
    if nodal is None:
        add_up(plan, wide, ratio, J)
        go_down(plan, wide, 1.0, ratio, J, V, T, off)
    else:
        nodal_step(plan, nodal, wide, 1.0, ratio, J, V, T, off)


@compiled(inner=True)
def _loss(plan, wide, V, J, ratio, loss):
    """Set ``loss`` to the losses of branches and cores, p.u.

    A branch loses Re(I^H B I), its input less its output. A core loses the draw of its conductance.
    """
    W = np.uint64(len(wide))
    for b in range(W):
        loss[b] = 0.0
    for k in range(1, plan.kind.shape[0]):  # none with nodal equations
        n, size = plan.first[k], plan.first[k + 1] - plan.first[k]
        for i in range(size):
            o, t = (n + i) * U2 * W, plan.regulator[n + i] * W
            if plan.kind[k] == REGULATOR:
                r = plan.z_re[k, i * U4]
                for b in range(W):
                    loss[b] += r * ratio[t + b] * ratio[t + b] * (J[o + b] * J[o + b] + J[o + W + b] * J[o + W + b])
                continue
            for j in range(size):
                u, r = (n + j) * U2 * W, plan.z_re[k, i * U3 + j]
                for b in range(W):
                    loss[b] += r * (J[o + b] * J[u + b] + J[o + W + b] * J[u + W + b])
    for k in range(plan.core_g.shape[0]):
        o, u = plan.core_ends[k, 0] * U2 * W, plan.core_ends[k, 1] * U2 * W
        for b in range(W):
            re, im = V[o + b] - V[u + b], V[o + W + b] - V[u + W + b]
            loss[b] += plan.core_g[k] * (re * re + im * im)


@compiled(inner=True)
def store_rows(columns, count, first, plan, nodal, wide, work, sweeps, is_good, out):
    """Hand over the first ``count`` of these columns of a block whose first row is ``first``.

    ``sweeps`` are those of each column. A row whose voltages cannot be is said not to have converged.
    """
    V, J, _, _, _, _, H, ratio, _, T, off = work
    v_pu, volts, amperes, per_row, converged, iterations = out
    W = np.uint64(len(wide))
    n_node = plan.up.shape[0]
    if nodal is not None:
        nodal_rest(plan, nodal, wide, V, T)
    _loss(plan, wide, V, J, ratio, T)
    if nodal is not None:
        nodal_loss(plan, nodal, wide, V, ratio, T)
        feeding_currents(plan, nodal, wide, V, J)
    for b in range(W):
        H[b], H[W + b] = V_SQ_CEILING, V_SQ_FLOOR
    for n in range(n_node):
        o = np.uint64(n) * U2 * W
        ampere = plan.ampere[n]
        for b in range(W):
            v_sq = V[o + b] * V[o + b] + V[o + W + b] * V[o + W + b]
            if plan.has_voltage[n]:
                H[b] = H[b] if H[b] < v_sq else v_sq
            H[W + b] = H[W + b] if H[W + b] > v_sq else v_sq
            T[W + b] = np.sqrt(v_sq)
        for c in range(count):
            b, row = columns[c], first + columns[c]
            v_pu[row, n] = T[W + b]
            volts[row, n], volts[row, n_node + n] = V[o + b], V[o + W + b]
            amperes[row, n], amperes[row, n_node + n] = J[o + b] * ampere, J[o + W + b] * ampere
    if nodal is not None:
        n_coupler = nodal.base_ratio.shape[0]
        for c in range(count):
            row = first + columns[c]
            for k in range(n_coupler):
                o = np.uint64(n_node + 4 + k) * U2 * W + columns[c]
                volts[row, 2 * n_node + k], volts[row, 2 * n_node + n_coupler + k] = V[o], V[o + W]
    failed = 0
    for c in range(count):
        b, row = columns[c], first + columns[c]
        p = q = 0.0
        for i in range(U3):
            entry = i * U2 * W + b
            p += V[entry] * J[entry] + V[entry + W] * J[entry + W]
            q += V[entry + W] * J[entry] - V[entry] * J[entry + W]
        per_row[0, row], per_row[1, row] = T[b] * PHASE_BASE_KVA, p * PHASE_BASE_KVA
        per_row[2, row], per_row[3, row] = q * PHASE_BASE_KVA, np.sqrt(off[b]) * PHASE_BASE_KVA
        converged[row] = is_good and H[b] > V_SQ_FLOOR and H[W + b] < V_SQ_CEILING
        iterations[row] = sweeps[b] if converged[row] or not is_good else 0
        failed += not converged[row]
    return failed
