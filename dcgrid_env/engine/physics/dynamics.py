"""The physics of one step: devices act within their limits, the grid settles. Pure, batched, on any array kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array, add_at, all_true, as_like, namespace, take_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.formula import PerSlot, compiled_as, formula, least, most
from dcgrid_env.devices import Work, converter
from dcgrid_env.devices.device import DeviceInput, DeviceParams
from dcgrid_env.engine.physics import equipment as feeder_equipment
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.physics.disconnection import connected_share, disconnectable_devices, supply
from dcgrid_env.engine.physics.node_figures import PhaseFigures, from_nodes, phase_figures
from dcgrid_env.engine.physics.parameters import Parameters, parameters
from dcgrid_env.engine.physics.state import Equipment, Exogenous, GridStep, State, ThreePhaseState, over_arrays
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow import (
    Control,
    Solver,
    branch_loading,
    has_ratings,
    solver_for,
    three_phase_nodes,
)
from dcgrid_env.powerflow.inputs import substation_voltage
from dcgrid_env.powerflow.unbalanced.sweep import solve_checked
from dcgrid_env.scenario.costs.utility_limits import remembered_draws
from dcgrid_env.scenario.scenario import Scenario


def initial_state(scenario: Scenario, exogenous: Exogenous) -> tuple[State, GridStep]:
    """Solve t = 0 with every channel at its initial setpoint: highest clocks, no reactive power.

    The taps of regulators that are controlled have settled.
    """
    like, n_row, feeder = exogenous.p_ref_kw, exogenous.nodes.shape[0], scenario.feeder
    xp, params = namespace(like), parameters(scenario, like)
    v, agents = (
        xp.full((n_row, width), start, dtype=like.dtype, device=like.device)
        for width, start in ((feeder.n_node, float(scenario.source_voltage_pu)), (scenario.n_agents, 0.0))
    )
    cuts = device_slices(scenario)
    devices = tuple(
        device.initial(device_params, agents[..., cut])
        for device, device_params, cut in zip(scenario.devices, params.devices, cuts, strict=True)
    )
    setpoints = tuple(
        tuple(agents[..., cut] + rest for rest in of_device) for of_device, cut in zip(params.rest, cuts, strict=True)
    )
    phases = None
    if isinstance(feeder, ThreePhaseFeeder):
        zeros = 0.0 * v[..., : len(three_phase_nodes(feeder))]
        angle = as_like(np.deg2rad(feeder.source_angle_deg[feeder.node_phase - 1]), v)
        at_agents = agents + scenario.source_voltage_pu
        phases = ThreePhaseState(v * xp.cos(angle), v * xp.sin(angle), at_agents, at_agents, zeros, None)
    before = State(v, v, agents, agents, None, agents, agents, agents, devices, phases)
    state, grid = _step(scenario, params, before, setpoints, agents, exogenous)
    draws = (state.p_kw,) * remembered_draws(scenario) or None
    views, phases = None, state.three_phase
    if phases is not None and (kept := feeder_equipment.remembered_reports(scenario)):
        views = (feeder_equipment.reported(scenario, phases.equipment, state.devices, exogenous.offset_v),) * kept
    return state._replace(
        v_last_pu=state.v_pu, v_agent_last_pu=state.v_agent_pu, p_window_kw=draws, regulator_views=views
    ), grid


def step(scenario: Scenario, state: State, action: Array, exogenous: Exogenous) -> tuple[State, GridStep]:
    """Advance every environment by one interval.

    Parameters
    ----------
    scenario
        The scenario, one for all environments.
    state
        State at the beginning of the interval.
    action
        (row, n_action) in [-1, 1], clipped: the channels of each agent in turn (``actions.ActionLayout``). A set point
        ranges from a channel's lowest value to its highest. A reactive set point is a share of the limit at zero active
        power, and is limited to the converter's capacity at its active power.
    exogenous
        Loads, drawn or to be drawn, p_ref and placement over the interval.

    Returns
    -------
    state, grid
        State at the end, and the power flow behind it. Where that has not converged the state keeps the last voltages.
    """
    params = parameters(scenario, action)
    setpoint = setpoints_of(scenario, action)
    by_device = [[setpoint[..., column] for column in columns] for columns in action_layout(scenario).columns]
    q_kvar = take_last(setpoint, params.reactive)
    if params.has_reactive is not None:
        q_kvar = q_kvar * params.has_reactive
    return _step(scenario, params, state, by_device, q_kvar, exogenous)


def _step(
    scenario: Scenario,
    params: Parameters,
    state: State,
    setpoints: Sequence[Any],
    q_setpoint_kvar: Array,
    exogenous: Exogenous,
) -> tuple[State, GridStep]:
    xp = namespace(q_setpoint_kvar)
    may_leave = disconnectable_devices(scenario)
    devices, draws = [], []
    for i in range(len(scenario.devices)):
        after, p_kw = device_step(scenario, params, state, i, setpoints[i], exogenous)
        devices.append(after)
        draws.append(p_kw)
    p_agent = draws[0] if len(draws) == 1 else xp.concat(draws, axis=-1)
    q_agent, q_limit = converter.dispatch(params.converter_kva, params.q_scale_kvar, p_agent, q_setpoint_kvar)
    if may_leave:
        share = connected_share(scenario, devices, p_agent, device_slices(scenario))
        q_agent, q_limit = q_agent * share, q_limit * share
    if exogenous.available is not None:
        p_agent, q_agent, q_limit = (values * exogenous.available for values in (p_agent, q_agent, q_limit))

    grid, equipment, figures = _solved(scenario, params, state, devices, exogenous, p_agent, q_agent)
    solution = grid.solution
    v, restart, phases, nodes = solution.v_pu, solution.restart, None, exogenous.nodes
    if equipment is not None:
        figures = figures or phase_figures(scenario, solution, nodes)
        v_agent, lowest, highest, unbalance, loading, voltages = figures
        phases = ThreePhaseState(solution.v_re_pu, solution.v_im_pu, lowest, highest, unbalance, equipment)
        grid = GridStep(solution, grid.noise, voltages)
    else:
        v_agent = from_nodes(v, nodes)
        loading = branch_loading(scenario.feeder, solution) if has_ratings(scenario.feeder) else None
    if not all_true(solution.converged):
        solved, last = solution.converged[..., None], 0.0 * restart if state.restart is None else state.restart
        v, restart = xp.where(solved, v, state.v_pu), xp.where(solved, restart, last)
        v_agent = from_nodes(v, nodes)
        if loading is not None:
            loading = xp.where(solved, loading, 0.0 * loading if state.loading is None else state.loading)
        if phases is not None:
            phases = over_arrays(lambda new, old: xp.where(solved, new, old), phases, state.three_phase)
    device_states, views = tuple(devices), state.regulator_views
    if phases is not None:
        device_states = feeder_equipment.with_measurements(scenario, device_states, phases.equipment)
        if views is not None:
            report = feeder_equipment.reported(scenario, phases.equipment, device_states, exogenous.offset_v)
            views = (*views[1:], report)
    return State(
        v_pu=v,
        v_last_pu=state.v_pu,
        v_agent_pu=v_agent,
        v_agent_last_pu=state.v_agent_pu,
        restart=restart,
        p_kw=p_agent,
        q_kvar=q_agent,
        q_limit_kvar=q_limit,
        devices=device_states,
        three_phase=phases,
        p_window_kw=None if state.p_window_kw is None else (*state.p_window_kw[1:], state.p_kw),
        loading=loading,
        regulator_views=views,
        request=exogenous.request,
    ), grid


def _solved(
    scenario: Scenario,
    params: Parameters,
    state: State,
    devices: Sequence[Any],
    exogenous: Exogenous,
    p_kw: Array,
    q_kvar: Array,
) -> tuple[GridStep, Equipment | None, PhaseFigures | None]:
    """The power flow under the agents' powers (row, n_agent), and the equipment of a three-phase feeder behind it.

    The third value are figures of the power flow, where they are known.
    """
    noise = None
    legs = exogenous.nodes if exogenous.legs is None else exogenous.legs
    if exogenous.to_draw is not None:
        if in_one_pass := _grid_pass(scenario):
            grid = in_one_pass(scenario, exogenous.to_draw, exogenous.nodes, p_kw, q_kvar, state.restart)
            return grid, None, None
        from dcgrid_env.engine.physics.loads import drawn  # brings the compiler with it

        exogenous, noise = drawn(scenario, exogenous)
    p_net, q_net = net_loads(exogenous.p_load_kw, exogenous.q_load_kvar, legs, p_kw, q_kvar)
    solve, changing = _grid(scenario)
    control = _control(scenario, params.devices, devices, exogenous) if changing else None
    if state.three_phase is None:
        solution = solve(scenario.feeder, p_net, q_net, scenario.source_voltage_pu, control, state.restart)
        return GridStep(solution, noise), None, None
    before, solve_rows = (
        state.three_phase.equipment,
        solve_rows_of(scenario, control, p_net, q_net, exogenous.capacitor_on),
    )
    equipment = _equipment(scenario, before, devices, exogenous, p_net, q_net, control)
    solution = solve_rows(equipment, slice(None), state.restart)
    if before is None:
        equipment = feeder_equipment.measured(scenario, equipment, solution)
    else:
        equipment, solution = feeder_equipment.with_controls(
            scenario, equipment, devices, exogenous.offset_v, solution, solve_rows
        )
    return GridStep(solution, noise), equipment, None


def solve_rows_of(
    scenario: Scenario, control: Control | None, p_net: Array, q_net: Array, connected: Array | None
) -> feeder_equipment.Solve:
    """Return the power flow of some rows of a three-phase feeder under these net loads, as a function of its equipment.

    ``control`` are the devices' changes to the grid, ``connected`` is ``Exogenous.capacitor_on``.
    """
    feeder: Any = scenario.feeder

    def solve_rows(equipment: Equipment, rows: Any, start: Array | None) -> Any:
        present = None if connected is None else connected[rows]
        of_feeder, p_kw, q_kvar = feeder_equipment.as_control(scenario, equipment, present), p_net[rows], q_net[rows]
        if control is None:
            source_pu = substation_voltage(feeder, p_kw, scenario.source_voltage_pu)
            return solve_checked(feeder, (p_kw, q_kvar, source_pu, of_feeder.tap_ratio, of_feeder.capacitor_on), start)
        changed = _with_equipment(Control(*(None if change is None else change[rows] for change in control)), of_feeder)
        return _grid(scenario)[0](feeder, p_kw, q_kvar, scenario.source_voltage_pu, changed, start)

    return solve_rows


def device_step(
    scenario: Scenario, params: Parameters, state: State, i: int, setpoints: Any, exogenous: Exogenous
) -> tuple[Any, Array]:
    """Advance the group of devices at position ``i`` by one interval under its set points; see ``Device.step``."""
    device_input = _device_input(scenario, i, exogenous)
    if i in disconnectable_devices(scenario):
        device_input = supply(scenario, state, exogenous, device_slices(scenario)[i], device_input)
    return scenario.devices[i].step(params.devices[i], state.devices[i], setpoints, device_input, scenario.dt_s)


def _device_input(scenario: Scenario, i: int, exogenous: Exogenous) -> DeviceInput:
    """Return the exogenous input of a device, see ``Device.input``."""
    source, available = scenario.devices[i].input, exogenous.available
    if available is not None and source in ("connection", "workload"):
        available = available[..., device_slices(scenario)[i]]
    if source == "workload":
        return Work(exogenous.p_ref_kw, exogenous.compute_share, available)
    return available if source == "connection" else exogenous.p_inverter_kw if source else None


@cached_on_owner
def _grid(scenario: Scenario) -> tuple[Solver, tuple[int, ...]]:
    """The solver of the feeder, and the positions of the devices that change the grid itself."""
    changing = tuple(i for i, device in enumerate(scenario.devices) if device.changes_grid)
    return solver_for(scenario.feeder, scenario.power_flow), changing


def _control(
    scenario: Scenario, params: tuple[DeviceParams, ...], states: Sequence[Any], exogenous: Exogenous
) -> Control:
    """Return the devices' changes to the grid: shunts at their nodes, taps in the order of the devices."""
    xp, cuts = namespace(exogenous.q_load_kvar), device_slices(scenario)
    shunt_kvar, ratios = None, []
    for i in _grid(scenario)[1]:
        change = scenario.devices[i].grid_change(params[i], states[i])
        if change.shunt_kvar is not None:
            nodes = exogenous.nodes[:, cuts[i]]
            zeros = 0.0 * exogenous.q_load_kvar[..., : scenario.feeder.n_node]
            shunt_kvar = add_at(zeros if shunt_kvar is None else shunt_kvar, nodes, _to_nodes(change.shunt_kvar, nodes))
        if change.tap_ratio is not None:
            ratios.append(change.tap_ratio)
    return Control(xp.concat(ratios, axis=-1) if ratios else None, shunt_kvar)


def _equipment(
    scenario: Scenario,
    before: Equipment | None,
    states: Sequence[Any],
    exogenous: Exogenous,
    p_net: Array,
    q_net: Array,
    control: Control | None,
) -> Equipment:
    """The equipment of a three-phase feeder over the step, from that of before; None before t = 0."""
    if before is not None:
        return feeder_equipment.advanced(scenario, before, states)
    shunt_kvar = None if control is None else control.shunt_kvar
    return feeder_equipment.initial_equipment(
        scenario, p_net, q_net, shunt_kvar, exogenous.capacitor_on, exogenous.offset_v
    )


def _with_equipment(control: Control, of_feeder: Control) -> Control:
    """Return the feeder's equipment for the power flow, with the shunts of devices, and taps where they set them."""
    ratio = of_feeder.tap_ratio if control.tap_ratio is None else control.tap_ratio
    return Control(ratio, control.shunt_kvar, of_feeder.capacitor_on)


@cached_on_owner
def device_slices(scenario: Scenario) -> tuple[slice, ...]:
    """Return the positions of each device's agents among all agents."""
    ends = np.cumsum([0, *(device.count for device in scenario.devices)]).tolist()
    return tuple(map(slice, ends[:-1], ends[1:]))


def setpoints_of(scenario: Scenario, action: Array) -> Array:
    """Set points of joint actions, (row, n_action), each in the unit of its channel."""
    params = parameters(scenario, action)
    return setpoints(action, params.middle, params.half_range)


@formula(like="action")
def setpoints(action: Array, middle: PerSlot, half_range: PerSlot) -> Array:
    """Setpoints of actions, which are cut to [-1, 1], (row, n_action): the middle of a range and a part of its half."""
    return middle + half_range * least(most(action, -1.0), 1.0)


@compiled_as("dcgrid_env.engine.physics.step_kernels:net_loads", like="p_load_kw")
def net_loads(p_load_kw: Array, q_load_kvar: Array, legs: Array, p_kw: Array, q_kvar: Array) -> tuple[Array, Array]:
    """Net load of each leg, kW and kvar, (row, n_leg): loads, and what agents draw less what they inject.

    ``legs`` (row, n_agent, k) are flat positions row * n_leg + leg. An agent's ``p_kw, q_kvar`` (row, n_agent) are
    shared in equal parts among its legs, and it may have a leg several times.
    """
    p_net = add_at(p_load_kw, legs, _to_nodes(p_kw, legs))
    return p_net, add_at(q_load_kvar, legs, _to_nodes(-q_kvar, legs))


@cached_on_owner
def _grid_pass(scenario: Scenario) -> Callable[..., GridStep] | None:
    """The pass that draws loads and solves the grid at once, where it can; it brings the compiler with it."""
    from dcgrid_env.engine.physics import grid_pass

    return grid_pass.grid_pass if grid_pass.fits(scenario) else None


def _to_nodes(values: Array, nodes: Array) -> Array:
    """Each agent's power in equal parts at its nodes, (row, n_agent, n_node)."""
    if nodes.shape[-1] == 1:
        return values[..., None]
    return namespace(values).broadcast_to((values / nodes.shape[-1])[..., None], nodes.shape)
