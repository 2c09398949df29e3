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
from dcgrid_env.powerflow.unbalanced.newton import OF_P, OF_Q, TINY, Equations, node_taps, places
from dcgrid_env.powerflow.unbalanced.nodal import coupler_ratios
from dcgrid_env.powerflow.unbalanced.plan import REGULATOR, plan_of
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution

_AT_ONCE = 64
"""Nodes whose derivatives are found together."""


def derivative(
    feeder: ThreePhaseFeeder, inputs: tuple[Any, ...], volts: Array, amperes: Array, weights: tuple[Any, ...]
) -> tuple[Any, ...]:
    """Derivatives by p_kw, q_kvar, source_pu, ratio and state of one power flow.

    Parameters
    ----------
    feeder, inputs
        Inputs of the power flow, without leading dimensions.
    volts, amperes
        Its ``restart`` and its currents, p.u. and A, real parts first, (2 n_unknown,) and (2 n_node,).
    weights
        Those of v_pu (n_node,), of ``volts`` and ``amperes``, and of loss, source p and source q (3,).
    """
    plan, n, (_, _, _, ratio, _) = plan_of(feeder), feeder.n_node, inputs
    v, i = volts[:n] + 1j * volts[n : 2 * n], (amperes[:n] + 1j * amperes[n:]) / plan.ampere
    of_magnitude, of_volts, of_amperes, (of_loss, of_p, of_q) = *weights[:3], weights[3] * PHASE_BASE_KVA
    to_v = of_magnitude * v / np.abs(v) + of_volts[:n] + 1j * of_volts[n:]
    to_i = (of_amperes[:n] + 1j * of_amperes[n:]) * plan.ampere
    to_v[:3] += (of_p + 1j * of_q) * i[:3]
    to_i[:3] += (of_p - 1j * of_q) * v[:3]
    grounded = np.append(v, 0.0)
    if feeder.is_radial:
        place, tap = places(feeder), node_taps(feeder, ratio)
        ohms = np.where(place.bus > 0, plan.z_re[place.bus, place.entry], 0.0) * tap[place.row] * tap[place.column]
        np.add.at(to_i, place.row, 2.0 * of_loss * ohms * i[place.column])
        others, of_source = i, to_i[:3]
    else:
        others, of_source = _coupler_currents(feeder, volts), to_i[:3]
        to_v, to_i = _to_unknowns(feeder, v, others, ratio, to_v, to_i, of_loss)
    in_cores, cores = np.zeros(n + 1, np.complex128), plan.core_ends.astype(np.intp)
    lost = 2.0 * of_loss * plan.core_g * (grounded[cores[:, 0]] - grounded[cores[:, 1]])
    np.add.at(in_cores, cores[:, 0], lost)
    np.subtract.at(in_cores, cores[:, 1], lost)
    to_v += in_cores[:n]

    equations = Equations(feeder, *inputs)
    slope = equations.evaluate(np.concatenate((v.real, others.real, v.imag, others.imag)), 1.0)[1]
    try:
        factors = splu(slope)
    except RuntimeError:  # exactly singular
        raise PowerFlowError(
            f"feeder {feeder.name!r}: there is no derivative at the largest load that the feeder can carry; reduce p_kw"
        ) from None
    mu = factors.solve(np.concatenate((to_v.real, to_i.real, to_v.imag, to_i.imag)), trans="T")
    mu = mu[: equations.half] + 1j * mu[equations.half :]
    mu_v, mu_i = mu[:n], mu[n:]
    of_draw = -equations.legs_sign * np.append(mu[equations.legs_at : equations.legs_at + n], 0.0)
    d_p, d_q = _by_powers(feeder, equations, grounded, of_draw)
    ideal = plan.source[:, 0] + 1j * plan.source[:, 1]
    if feeder.is_radial:
        d_source = (np.conj(mu_v[:3]) * ideal).real.sum()
        d_ratio = _by_ratios(feeder, ratio, v, i, mu_v, mu_i, of_loss)
    else:
        d_source = (np.conj(mu_v[:3] + of_source) * (feeder.nodal.source_y @ ideal)).real.sum()
        d_ratio = _by_couplers(feeder, ratio, grounded, others, np.append(mu_v, 0.0), mu_i, of_loss)
    d_state, banks = np.zeros(feeder.n_capacitor), plan.capacitor_ends.astype(np.intp)
    across, to = (a[banks[:, 0]] - a[banks[:, 1]] for a in (grounded, of_draw))
    np.add.at(d_state, plan.capacitor_row.astype(np.intp), (np.conj(to) * 1j * plan.capacitor_b * across).real)
    return d_p, d_q, d_source, d_ratio, d_state


def _by_powers(feeder: ThreePhaseFeeder, equations: Equations, v: Array, mu_i: Array) -> tuple[Any, Any]:
    plan, n_load = plan_of(feeder), feeder.first_device_leg
    across, to = (a[equations.ends[:, 0]] - a[equations.ends[:, 1]] for a in (v, mu_i))
    both, squared = np.conj(to) * across, np.abs(across) ** 2
    inverse = np.sqrt(plan.leg_law[:, 1] / squared[:n_load])
    by_power = []
    for of_leg, rows in ((both.real, OF_P), (both.imag, OF_Q)):
        at_legs = of_leg / (PHASE_BASE_KVA * np.maximum(squared, TINY))
        h = equations.shares(inverse, *rows)[0]
        at_legs[plan.leg_order.astype(np.intp)] = plan.leg_law[:, 0] * h * of_leg[:n_load]
        by_power.append(at_legs)
    return by_power[0], by_power[1]


def _by_ratios(
    feeder: ThreePhaseFeeder, ratio: Array, v: Array, i: Array, mu_v: Array, mu_i: Array, of_loss: Array
) -> Array:
    plan = plan_of(feeder)
    nodes = np.flatnonzero((plan.kind == REGULATOR)[feeder.node_bus])
    bus, above, row = feeder.node_bus[nodes], plan.up.astype(np.intp)[nodes], plan.regulator.astype(np.intp)[nodes]
    entry = 4 * (nodes - feeder.first_node[bus])
    z, r, current = plan.z_re[bus, entry] + 1j * plan.z_im[bus, entry], ratio[row], i[nodes]
    moved = np.conj(mu_v[nodes]) * (v[above] - 2.0 * r * z * current) + np.conj(mu_i[above]) * current
    by_ratio = np.zeros(feeder.n_regulator)
    np.add.at(by_ratio, row, moved.real + 2.0 * of_loss * r * z.real * np.abs(current) ** 2)
    return by_ratio


def _coupler_currents(feeder: ThreePhaseFeeder, restart: Array) -> Array:
    """Currents of the couplers in what a power flow starts from, p.u."""
    first, n = 2 * feeder.n_node, feeder.n_unknown - feeder.n_node
    return restart[first : first + n] + 1j * restart[first + n :]


def _to_unknowns(
    feeder: ThreePhaseFeeder, v: Array, currents: Array, ratio: Array, to_v: Array, to_i: Array, of_loss: float
) -> tuple[Any, Any]:
    """Weights of voltages and of couplers' currents, from those of voltages, of feeding currents and of the loss."""
    nodal, tap = feeder.nodal, coupler_ratios(feeder, ratio)
    coupled = np.flatnonzero(nodal.feed_coupler >= 0)
    to_v = to_v + nodal.feed.conj().T @ to_i + 2.0 * of_loss * (nodal.y.real @ v)
    to_v[:3] -= np.conj(nodal.source_y).T @ to_i[:3]
    to_couplers = 2.0 * of_loss * (nodal.coupler_z.real * tap**2 * currents + nodal.coupler_mutual.real @ currents)
    np.add.at(to_couplers, nodal.feed_coupler[coupled], nodal.feed_sign[coupled] * to_i[coupled])
    return to_v, to_couplers


def voltage_slopes(
    feeder: ThreePhaseFeeder, inputs: tuple[Any, ...], solution: ThreePhaseSolution, nodes: np.ndarray
) -> tuple[Any, Any]:
    """Derivatives of the voltage magnitudes of some nodes of a feeder that is not radial, a row each.

    They are by p_kw and q_kvar of the devices' legs (node, n_node). The nodal equations of the one power flow are
    factored once.
    """
    v = solution.v_re_pu + 1j * solution.v_im_pu
    others = _coupler_currents(feeder, solution.restart)
    equations = Equations(feeder, *inputs)
    factors = splu(equations.evaluate(np.concatenate((v.real, others.real, v.imag, others.imag)), 1.0)[1])
    per_v = v / np.maximum(np.abs(v) ** 2, TINY) / PHASE_BASE_KVA
    slopes: list[Any] = []
    for first in range(0, len(nodes), _AT_ONCE):
        some = nodes[first : first + _AT_ONCE]
        weights = np.zeros((2 * equations.half, len(some)))
        unit, column = v[some] / np.maximum(np.abs(v[some]), TINY), np.arange(len(some))
        weights[some, column], weights[equations.half + some, column] = unit.real, unit.imag
        mu = factors.solve(weights, trans="T").T
        mu = mu[:, : equations.half] + 1j * mu[:, equations.half :]
        slopes.append(np.conj(-mu[:, : feeder.n_node]) * per_v)
    both: Any = np.concatenate(slopes)
    return both.real, both.imag


def _by_couplers(
    feeder: ThreePhaseFeeder, ratio: Array, v: Array, currents: Array, mu_v: Array, mu_c: Array, of_loss: float
) -> Array:
    """Derivatives by the ratios of the regulators; the last of ``v`` and ``mu_v`` is ground."""
    nodal, tap, by_ratio = feeder.nodal, coupler_ratios(feeder, ratio), np.zeros(feeder.n_regulator)
    tapped = np.flatnonzero(nodal.coupler_regulator >= 0)
    f, g = nodal.coupler_ends[tapped, :2].T
    z, r, i = nodal.coupler_z[tapped], tap[tapped], currents[tapped]
    moved = np.conj(mu_v[f] - mu_v[g]) * i + np.conj(mu_c[tapped]) * (v[f] - v[g] - 2.0 * r * z * i)
    np.add.at(by_ratio, nodal.coupler_regulator[tapped], 2.0 * of_loss * r * z.real * np.abs(i) ** 2 - moved.real)
    return by_ratio
