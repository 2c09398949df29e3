"""Compiled derivative of a solved sweep: the effect of each input on a weighted sum of the solution's figures.

The solution satisfies V_m = A V_n - B I_m and I_m = (currents of the legs at V_m) + sum of A^T I over the buses that m
feeds. The derivative follows from these alone (the implicit function theorem). With a bar for the derivative of the
weighted sum by a real and an imaginary part, and N the two by two real derivative of a bus's currents by its voltages,

    vbar_m = weight of V + N^T ibar_m + sum over what m feeds of A^T vbar
    ibar_m = weight of I + A ibar_n - conj(B) vbar_m

This is the same sweep, with ibar for the voltage, vbar for the current, conjugated matrices and a source of zero.
With nodal equations M x = s - J(V) the same holds of conj(M) ibar = -(weights + N^T ibar).
"""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled
from dcgrid_env.powerflow.unbalanced.adjoint_blocks import (
    clear_inactive,
    current_weights,
    hand_over,
    leg_derivatives,
    legs_transposed,
    load_weights,
)
from dcgrid_env.powerflow.unbalanced.nodal_adjoint import nodal_hand_over, nodal_weights
from dcgrid_env.powerflow.unbalanced.nodal_kernels import nodal_step
from dcgrid_env.powerflow.unbalanced.row_blocks import core_currents, load_row, workspace
from dcgrid_env.powerflow.unbalanced.sweep_kernels import (
    add_up,
    capacitor_currents,
    go_down,
    shunt_currents,
)
from dcgrid_env.powerflow.unbalanced.sweep_rows import error_sq

SWEEPS = 400
TOLERANCE = 1e-9
"""Largest estimated error of ibar, as a share of its largest after the first sweep."""


@compiled(inner=True)
def _transposed(plan, nodal, wide, N, off_on, G, Y, X):
    """Set X to G plus what the legs' transposed derivatives make of Y, and nothing added up yet."""
    if nodal is None:
        shunt_currents(plan, wide, -1.0, Y, X)
    else:
        n = 2 * plan.up.shape[0] * len(wide)
        for k in range(n):
            X[k] = 0.0
        for k in range(n, X.shape[0]):  # of the couplers
            X[k] = G[k]
    capacitor_currents(plan, wide, Y, off_on, X)
    core_currents(plan, wide, -1.0, Y, X)
    legs_transposed(plan, wide, N, G, Y, X)


@compiled(inner=True)
def _settle(plan, nodal, wide, count, least, N, off_on, ratio, G, Y, X, T, off, is_good):
    """Sweep ``least`` times and until ibar (Y) stands still in the first ``count`` columns; the number of sweeps.

    X is then vbar, added up, and ``is_good`` says in which columns ibar stands still.
    """
    before, scale = np.ones(len(wide)), np.zeros(len(wide))
    for k in range(Y.shape[0]):
        Y[k] = 0.0
    for sweep in range(SWEEPS):
        _transposed(plan, nodal, wide, N, off_on, G, Y, X)
        if nodal is None:
            add_up(plan, wide, ratio, X)
            go_down(plan, wide, -1.0, ratio, X, Y, T, off)
        else:
            nodal_step(plan, nodal, wide, -1.0, ratio, X, Y, T, off)
        settled = sweep > 0
        for b in range(count):
            if sweep == 0:
                scale[b] = off[b]
                is_good[b] = off[b] == 0.0
            elif scale[b] > 0.0:
                error = error_sq(off[b] / scale[b], before[b])
                is_good[b] = error <= TOLERANCE * TOLERANCE
                settled = settled and is_good[b]
                before[b] = off[b] / scale[b]
        if settled and sweep + 1 >= least:
            return sweep + 1
    return SWEEPS


@compiled(nogil=True)
def sweep_adjoint_rows(plan, nodal, wide, inputs, solved, weights, converged, least, settled, out):
    """Fill ``out`` with derivatives of sum(weights * figures), in blocks of rows of width ``wide``.

    ``inputs`` is the argument of ``sweep_rows``; ``solved`` holds ``restart`` and currents in A (row, 2 node).
    ``weights`` holds those of v_pu (row, node), of volts and currents (row, 2 node) and of loss, source p and q
    (3, row); one without rows is zero. ``out`` holds the derivatives by p_kw, q_kvar (row, leg), source_pu (row,),
    ratio (row, regulator) and state (row, bank). A row without a solution has no derivative and gets 0.
    ``settled`` (row,) marks the rows whose derivative was found. Each block takes ``least`` sweeps or more. Returns
    the most sweeps of a block.
    """
    width, n_row, n_node = len(wide), converged.shape[0], plan.up.shape[0]
    work = workspace(plan, nodal, wide, inputs)
    V, J, P, Q, DP, DQ, H, ratio, on, T, off = work
    rows = V.shape[0]
    X, Y, G, K = np.zeros(rows), np.zeros(rows), np.zeros(rows), np.zeros(rows)
    N = np.zeros((n_node + plan.leg_is_z.shape[0]) * 4 * width)
    loss, is_good = np.zeros(width), np.ones(width, np.bool_)
    off_on = np.empty_like(on)
    most = 0
    nodes = np.arange(n_node).astype(np.uint64)
    for first in range(0, n_row, width):
        count = min(width, n_row - first)
        for b in range(width):
            row = first + min(b, count - 1)
            load_row(b, row, plan, wide, inputs, nodes, n_node, work)
        for k in range(on.shape[0]):
            off_on[k] = -on[k]
        has_currents = load_weights(first, count, plan, wide, solved, weights, V, J, G, loss)
        if nodal is not None:
            nodal_weights(first, count, plan, nodal, wide, solved, weights, converged, V, ratio, loss, G, K)
        clear_inactive(first, count, plan, wide, converged, V, J, P, Q, DP, DQ, G, loss)
        leg_derivatives(plan, wide, V, P, Q, DP, DQ, N)
        if nodal is None and has_currents:  # what they weigh goes down the tree once, and from there through the legs
            for k in range(K.shape[0]):
                X[k] = 0.0
            current_weights(first, count, plan, wide, weights, converged, V, J, ratio, loss, K)
            _transposed(plan, nodal, wide, N, off_on, G, K, X)
            for k in range(2 * n_node * width):
                G[k] = X[k]
        most = max(most, _settle(plan, nodal, wide, count, least, N, off_on, ratio, G, Y, X, T, off, is_good))
        for b in range(count):
            settled[first + b] = is_good[b]
        if nodal is None and has_currents:
            for k in range(2 * n_node * width):
                Y[k] += K[k]
        hand_over(first, count, plan, wide, V, J, X, Y, ratio, loss, H, out)
        if nodal is not None:
            nodal_hand_over(first, count, plan, nodal, wide, V, Y, K, ratio, loss, out)
    return most
