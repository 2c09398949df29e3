"""The derivative of one solved three-phase power flow from Newton's equations, used if the sweep's does not settle.

At the solution the equations F(x, inputs) = 0 of ``newton`` hold. Let g be the weights of x, and mu the solution of
(dF/dx)^T mu = g. The derivative of the weighted sum by an input is its derivative at a fixed x, less mu^T dF/dinput.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.linalg import splu

from dcgrid_env.core.arrays import Array
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA
from dcgrid_env.powerflow.solution import PowerFlowError
from dcgrid_env.powerflow.unbalanced.newton import Equations, places, tap_of_nodes
from dcgrid_env.powerflow.unbalanced.plan import REGULATOR, plan_of


def derivative(
    feeder: ThreePhaseFeeder, inputs: tuple[Any, ...], volts: Array, amperes: Array, weights: tuple[Any, ...]
) -> tuple[Any, ...]:
    """Derivatives by p_kw, q_kvar, source_pu, ratio and state of one power flow.

    Parameters
    ----------
    feeder, inputs
        Inputs of the power flow, without leading dimensions.
    volts, amperes
        Its solution, p.u. and A, real parts first, (2 n_node,).
    weights
        Those of v_pu (n_node,), of ``volts`` and ``amperes``, and of loss, source p and source q (3,).
    """
    plan, n, (_, _, _, ratio, _) = plan_of(feeder), feeder.n_node, inputs
    v, i = volts[:n] + 1j * volts[n:], (amperes[:n] + 1j * amperes[n:]) / plan.ampere
    of_magnitude, of_volts, of_amperes, (of_loss, of_p, of_q) = *weights[:3], weights[3] * PHASE_BASE_KVA
    to_v = of_magnitude * v / np.abs(v) + of_volts[:n] + 1j * of_volts[n:]
    to_i = (of_amperes[:n] + 1j * of_amperes[n:]) * plan.ampere
    to_v[:3] += (of_p + 1j * of_q) * i[:3]
    to_i[:3] += (of_p - 1j * of_q) * v[:3]
    place, tap, grounded = places(feeder), tap_of_nodes(feeder, ratio), np.append(v, 0.0)
    resistance = np.where(place.bus > 0, plan.z_re[place.bus, place.entry], 0.0) * tap[place.row] * tap[place.column]
    np.add.at(to_i, place.row, 2.0 * of_loss * resistance * i[place.column])
    in_cores, cores = np.zeros(n + 1, np.complex128), plan.core_ends.astype(np.intp)
    lost = 2.0 * of_loss * plan.core_g * (grounded[cores[:, 0]] - grounded[cores[:, 1]])
    np.add.at(in_cores, cores[:, 0], lost)
    np.subtract.at(in_cores, cores[:, 1], lost)
    to_v += in_cores[:n]

    equations = Equations(feeder, *inputs)
    slope = equations.evaluate(np.concatenate((v.real, i.real, v.imag, i.imag)), 1.0)[1]
    try:
        factors = splu(slope)
    except RuntimeError:  # exactly singular
        raise PowerFlowError(
            f"feeder {feeder.name!r}: there is no derivative at the largest load that the feeder can carry; reduce p_kw"
        ) from None
    mu = factors.solve(np.concatenate((to_v.real, to_i.real, to_v.imag, to_i.imag)), trans="T")
    mu_v, mu_i = mu[:n] + 1j * mu[2 * n : 3 * n], mu[n : 2 * n] + 1j * mu[3 * n :]
    d_p, d_q = _by_powers(feeder, equations, grounded, np.append(mu_i, 0.0))
    d_source = (np.conj(mu_v[:3]) * (plan.source[:, 0] + 1j * plan.source[:, 1])).real.sum()
    d_ratio = _by_ratios(feeder, ratio, v, i, mu_v, mu_i, of_loss)
    d_state, banks = np.zeros(feeder.n_capacitor), plan.capacitor_ends.astype(np.intp)
    across, to = (a[banks[:, 0]] - a[banks[:, 1]] for a in (grounded, np.append(mu_i, 0.0)))
    np.add.at(d_state, plan.capacitor_row.astype(np.intp), (np.conj(to) * 1j * plan.capacitor_b * across).real)
    return d_p, d_q, d_source, d_ratio, d_state


def _by_powers(feeder: ThreePhaseFeeder, equations: Equations, v: Array, mu_i: Array) -> tuple[Any, Any]:
    plan, n_load = plan_of(feeder), feeder.first_device_leg
    across, to = (a[equations.ends[:, 0]] - a[equations.ends[:, 1]] for a in (v, mu_i))
    both, squared = np.conj(to) * across, np.abs(across) ** 2
    inverse = np.sqrt(plan.leg_law[:, 1] / squared[:n_load])
    found = []
    for of_leg, first, line in ((both.real, 2, 11), (both.imag, 5, 13)):
        at_legs = of_leg / (PHASE_BASE_KVA * squared)
        h = equations.shares(inverse, first, line)[0]
        at_legs[plan.leg_order.astype(np.intp)] = plan.leg_law[:, 0] * h * of_leg[:n_load]
        found.append(at_legs)
    return found[0], found[1]


def _by_ratios(
    feeder: ThreePhaseFeeder, ratio: Array, v: Array, i: Array, mu_v: Array, mu_i: Array, of_loss: Array
) -> Array:
    plan = plan_of(feeder)
    nodes = np.flatnonzero((plan.kind == REGULATOR)[feeder.node_bus])
    bus, above, row = feeder.node_bus[nodes], plan.up.astype(np.intp)[nodes], plan.regulator.astype(np.intp)[nodes]
    entry = 4 * (nodes - feeder.first_node[bus])
    z, r, current = plan.z_re[bus, entry] + 1j * plan.z_im[bus, entry], ratio[row], i[nodes]
    moved = np.conj(mu_v[nodes]) * (v[above] - 2.0 * r * z * current) + np.conj(mu_i[above]) * current
    found = np.zeros(feeder.n_regulator)
    np.add.at(found, row, moved.real + 2.0 * of_loss * r * z.real * np.abs(current) ** 2)
    return found
