"""Compiled passes before and after the power flow of a single environment on a three-phase feeder.

They replace a dozen calls of kernels and array operations, each of which takes about as long as a tenth of the power
flow. Each part is also used alone, with the same bits. The general path solves steps in which a control acts.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.compiled import compiled
from dcgrid_env.core.coverage import Coverage
from dcgrid_env.core.random import load_step
from dcgrid_env.devices.capacitor_bank.bank_switching import BankState
from dcgrid_env.devices.tap_changer.regulator_state import RegulatorState
from dcgrid_env.devices.tap_changer.relay import RelayBand, RelaySettings
from dcgrid_env.devices.tap_changer.tap_kernels import next_taps, relay_volts
from dcgrid_env.engine.physics.equipment import built_in_control
from dcgrid_env.engine.physics.known_fields import OUTSIDE, SCENARIO
from dcgrid_env.engine.physics.loads import base_legs, load_noise
from dcgrid_env.engine.physics.node_figures import PhaseFigures, as_figures, constants
from dcgrid_env.engine.physics.state import Equipment, Exogenous, State
from dcgrid_env.engine.physics.step_kernels import leg_loads, net_loads, phase_figures
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.covered_fields import THREE_PHASE
from dcgrid_env.powerflow.inputs import substation_voltage
from dcgrid_env.powerflow.unbalanced.sweep import solve_checked
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution
from dcgrid_env.scenario.background import Background
from dcgrid_env.scenario.load_profiles import LoadProfiles
from dcgrid_env.scenario.scenario import Scenario

COVERED = Coverage(
    SCENARIO
    | THREE_PHASE
    | {
        Scenario: """
            name feeder* source_voltage_pu devices* workload background sensing cost grid_control grid_request
            load_profiles sags* horizon dt_s power_flow split
        """,
        Background: "load_sigma load_rho start_hour",
        LoadProfiles: "",
    },
    arrays={
        **OUTSIDE,
        Equipment: "regulators banks",
        RegulatorState: "tap relay_v out_of_band_s in_sequence since_s moved moves",
        BankState: "on v_pu value beyond_s since_s switched switchings",
    },
)
"""What a pass covers. Devices of any class act on the grid by their powers, unless they change the grid itself."""


class PhasePass(NamedTuple):
    """Result of a pass."""

    noise: np.ndarray
    """The load noise at the end of the interval, (1, n_bus)."""
    p_net_kw: np.ndarray
    """Net load of each leg, (1, n_leg)."""
    q_net_kvar: np.ndarray
    solution: ThreePhaseSolution
    """The power flow under the equipment of the step's beginning."""
    end: tuple[Equipment, PhaseFigures] | None
    """The equipment at the end of the step, and figures of the power flow; None where a control acts before the end, or
    there is no solution."""


def fits(scenario: Scenario) -> bool:
    """Whether a pass does all that a step asks of the grid: regulators with constant set points, loads without
    profiles, connected capacitors, no faults, and no other equipment that may change."""
    feeder = scenario.feeder
    if type(feeder) is not ThreePhaseFeeder or not COVERED.includes(scenario, feeder):
        return False
    changed = any(device.changes_grid for device in scenario.devices)
    return not changed and built_in_control(scenario) is not None


def phase_pass(scenario: Scenario, exogenous: Exogenous, state: State, p_kw: Any, q_kvar: Any) -> PhasePass:
    """Draw the loads of an interval and solve the grid under the agents' powers, kW and kvar, (1, n_agent).

    The loads of ``exogenous`` are still to be drawn, and ``state`` is that before the step. PowerFlowError for a power
    that is not finite.
    """
    feeder: Any = scenario.feeder
    drawing: Any = exogenous.to_draw
    of_loads, of_relays, left_s = _fixed(scenario)
    regulators, banks = state.three_phase.equipment  # pyright: ignore[reportOptionalMemberAccess]
    noise, p_net, q_net, ratio = _before(*drawing[:4], *of_loads, exogenous.legs, p_kw, q_kvar, regulators.tap)
    inputs = (p_net, q_net, substation_voltage(feeder, p_net, scenario.source_voltage_pu), ratio, banks.on)
    solution, end = solve_checked(feeder, inputs, state.restart), None
    after, *figures = _after(*solution[:5], exogenous.nodes, left_s, *regulators, *of_relays, *constants(scenario))
    if solution.converged[0] and after[7, 0, 0] == scenario.dt_s:
        taps = RegulatorState(after[0], after[1], after[2], after[3], after[4], after[5], after[6])
        since_s = banks.since_s + scenario.dt_s
        end = Equipment(taps, banks._replace(since_s=since_s, switched=0.0 * since_s)), as_figures(scenario, *figures)
    return PhasePass(noise, p_net, q_net, solution, end)


@cached_on_owner
def _fixed(scenario: Scenario) -> tuple[tuple[Any, ...], tuple[Any, ...], np.ndarray]:
    """Return the constants of the scenario for both kernels, and the length of a step as an array."""
    feeder, control = scenario.feeder, built_in_control(scenario)
    if not isinstance(feeder, ThreePhaseFeeder) or control is None:
        raise ValueError("a pass needs a three-phase feeder whose regulators are controlled")
    settings, band, controlled, integrating = control
    tap_step = np.array(feeder.network.regulator.tap_step, np.float64)
    of_loads = (*load_noise(scenario), *base_legs(feeder), tap_step)
    return of_loads, (*settings, *band, controlled, integrating), np.full((1, 1), scenario.dt_s)


@compiled
def _before(
    key, step, noise, share, rho, sigma, p_base, q_base, q_fixed, leg_bus, p_leg, q_leg, tap_step, legs, p_kw, q_kvar,
    tap,
):  # fmt: skip
    """Return the load noise, the net loads and the regulators' ratios of an interval."""
    drawn = np.empty((3, 1, noise.shape[1]))
    load_step(key, step, noise, share, rho, sigma, p_base, q_base, q_fixed, drawn[0], drawn[1], drawn[2])
    p_load, q_load = leg_loads(drawn[1], leg_bus, p_leg, q_leg)
    p_net, q_net = net_loads(p_load, q_load, legs, p_kw, q_kvar)
    ratio = np.empty(tap.shape)
    for i in range(tap.shape[1]):  # a loop compiles faster than an operation on arrays
        ratio[0, i] = 1.0 + tap_step[i] * tap[0, i]
    return drawn[0], p_net, q_net, ratio


@compiled
def _after(
    v_pu, v_re_pu, v_im_pu, i_re_a, i_im_a, agent_nodes, left_s,
    tap, relay_v, out_of_band_s, in_sequence, since_s, moved, moves,
    node, other, is_between, volts_per_pu, r_ohm, x_ohm, z_ohm, target_v, half_band_v, delay_s, tap_delay_s, lowest,
    highest, volts_per_tap, band_v, half_v, controlled, integrating,
    bus_nodes, rated, before, per_a, first, band_pu,
):  # fmt: skip
    """Return the regulators after the next event, (8, 1, n_regulator), as ``next_taps``, and ``phase_figures``.

    Each array is an argument, because the compiler's dispatcher takes several times as long for tuples of arrays.
    """
    settings = RelaySettings(
        node, other, is_between, volts_per_pu, r_ohm, x_ohm, z_ohm, target_v, half_band_v, delay_s, tap_delay_s, lowest,
        highest, volts_per_tap,
    )  # fmt: skip
    volts = relay_volts(settings, v_re_pu, v_im_pu, i_re_a, i_im_a)
    state = RegulatorState(tap, volts, out_of_band_s, in_sequence, since_s, np.zeros(moved.shape), moves)
    after = next_taps(settings, state, RelayBand(band_v, half_v), left_s, left_s, integrating, controlled)
    agents, unbalance, loading, per_row = phase_figures(
        v_pu, v_re_pu, v_im_pu, i_re_a, i_im_a, agent_nodes, bus_nodes, rated, before, per_a, first, band_pu
    )  # fmt: skip
    return after, agents, unbalance, loading, per_row
