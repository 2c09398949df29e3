"""The physics of one step: devices act within their limits, the grid settles. Pure, batched, on any array kind."""

from __future__ import annotations

from typing import NamedTuple

from dcgrid_env.core.arrays import Array, add_at, all_true, namespace, take_at
from dcgrid_env.devices import converter
from dcgrid_env.devices.datacenter import datacenter
from dcgrid_env.engine.parameters import constants
from dcgrid_env.powerflow import Solution, distflow, lindistflow
from dcgrid_env.scenario.scenario import Scenario


class Exogenous(NamedTuple):
    """What comes from outside over one interval; nothing here depends on an action."""

    p_load_kw: Array
    """Other loads, kW, (lane, n_bus)."""
    q_load_kvar: Array
    """Other loads less capacitors, kvar, (lane, n_bus)."""
    p_ref_kw: Array
    """What the data centres would draw at the top clock with nothing queued, kW, (lane, n_dc)."""
    p_inverter_kw: Array
    """Scheduled active injection of the inverters, kW, (lane, n_inv)."""
    nodes: Array
    """Where each agent is connected, flat positions lane * n_bus + bus, int, (lane, n_agent, n_node). An agent sees the
    mean voltage of its nodes and its power is shared equally among them; a balanced feeder has one node an agent."""
    compute_share: Array | None = None
    """Compute-bound share of the work that arrives, (lane, n_dc); None under a clock law of one work class."""
    available: Array | None = None
    """1 for an agent that is connected to the grid and 0 for one that is not, (lane, n_agent); None where all are."""


class State(NamedTuple):
    """The state after a step; every array has the lanes as its leading dimension, agents are data centres first."""

    v_pu: Array
    """Voltage, p.u., (lane, n_bus); the last solved one where the power flow has none."""
    v_last_pu: Array
    """The same one step earlier."""
    v_agent_pu: Array
    """Voltage at the agents, p.u., (lane, n_agent)."""
    v_agent_last_pu: Array
    current_sq_pu: Array
    """Squared branch current, per unit, (lane, n_bus - 1): the next solution's start."""
    backlog_kws: Array
    """Queued work, kW s, (lane, n_dc)."""
    f_mhz: Array
    """Clock, MHz, (lane, n_dc)."""
    f_last_mhz: Array
    arrived_kw: Array
    """Dynamic power asked for by work that arrived in the interval, kW, (lane, n_dc)."""
    served_kw: Array
    """Dynamic power of work served in it, kW, (lane, n_dc)."""
    p_kw: Array
    """Draw from the grid, kW (an inverter's injection is negative), (lane, n_agent); 0 where disconnected."""
    q_kvar: Array
    """Reactive injection as dispatched, kvar, (lane, n_agent)."""
    q_limit_kvar: Array
    """Largest reactive magnitude at this active power, kvar, (lane, n_agent)."""
    class_backlog_kws: Array
    """Backlog, work arrived and work served by work class, compute-bound first, (lane, n_dc, 2), each first come first
    served; under a clock law of one work class what stands in the fields without class."""
    class_arrived_kw: Array
    class_served_kw: Array


def initial_state(scenario: Scenario, exogenous: Exogenous) -> tuple[State, Solution]:
    """Solve t = 0 at the top clock and without reactive power, starting from empty queues."""
    xp = namespace(exogenous.p_load_kw)
    v = 0.0 * exogenous.p_load_kw + scenario.v0_pu
    agents = 0.0 * xp.concat((exogenous.p_ref_kw, exogenous.p_inverter_kw), axis=-1)
    none = 0.0 * exogenous.p_ref_kw
    by_class = xp.stack((none, none), axis=-1) if scenario.work_classes == 2 else none
    top = none + scenario.f_max_mhz
    before = State(
        v, v, agents, agents, 0.0 * v[..., 1:], none, top, top, none, none, agents, agents, agents, by_class, by_class,
        by_class,
    )  # fmt: skip
    state, solution = _step(scenario, before, top, agents, exogenous)
    return state._replace(v_last_pu=state.v_pu, v_agent_last_pu=state.v_agent_pu), solution


def step(scenario: Scenario, state: State, action: Array, exogenous: Exogenous) -> tuple[State, Solution]:
    """Advance every lane by one interval.

    Parameters
    ----------
    scenario
        The scenario, the same for all lanes.
    state
        State at the beginning of the interval.
    action
        (lane, n_action) in [-1, 1], clipped: clock and reactive setpoint of each data centre in turn, then the
        inverters' reactive setpoints. The clock runs from f_min to f_max; a reactive setpoint is a share of the limit
        at zero active power, and what the device cannot give at its active power is cut.
    exogenous
        Loads, p_ref and placement over the interval.

    Returns
    -------
    state, solution
        State at the end and the power flow behind it. Where that has not converged the state keeps the last voltages.
    """
    xp = namespace(action)
    known = constants(scenario, action)
    action = xp.minimum(xp.maximum(action, known.minus_one), known.one)
    n_dc = scenario.n_datacenters
    clock, q_dc, q_inv = action[..., 0 : 2 * n_dc : 2], action[..., 1 : 2 * n_dc : 2], action[..., 2 * n_dc :]
    f_mhz = known.f_middle_mhz + known.f_half_range_mhz * clock
    q = xp.concat((q_dc, q_inv), axis=-1) * known.q_scale_kvar
    return _step(scenario, state, f_mhz, q, exogenous)


def _step(
    scenario: Scenario, state: State, f_mhz: Array, q_setpoint_kvar: Array, exogenous: Exogenous
) -> tuple[State, Solution]:
    xp = namespace(f_mhz)
    known = constants(scenario, f_mhz)
    dc = datacenter.step(
        known.datacenter, scenario.dvfs, state.class_backlog_kws, exogenous.p_ref_kw, f_mhz, scenario.dt_s,
        exogenous.compute_share, boost=scenario.boost_share > 1.0,
    )  # fmt: skip
    p_agent = xp.concat((dc.p_kw, -exogenous.p_inverter_kw), axis=-1)
    q_agent, q_limit = converter.dispatch(known.s_rated_kva, known.q_scale_kvar, p_agent, q_setpoint_kvar)
    if exogenous.available is not None:
        p_agent, q_agent, q_limit = (values * exogenous.available for values in (p_agent, q_agent, q_limit))

    nodes = exogenous.nodes
    p_net = add_at(exogenous.p_load_kw, nodes, _to_nodes(p_agent, nodes))
    q_net = add_at(exogenous.q_load_kvar, nodes, _to_nodes(-q_agent, nodes))
    if scenario.power_flow == "distflow":
        solution = distflow(scenario.feeder, p_net, q_net, scenario.v0_pu, warm=state.current_sq_pu)
    else:
        solution = lindistflow(scenario.feeder, p_net, q_net, scenario.v0_pu)
    v, current_sq = solution.v_pu, solution.current_sq_pu
    if not all_true(solution.converged):
        solved = solution.converged[..., None]
        v, current_sq = xp.where(solved, v, state.v_pu), xp.where(solved, current_sq, state.current_sq_pu)
    return State(
        v_pu=v,
        v_last_pu=state.v_pu,
        v_agent_pu=from_nodes(v, nodes),
        v_agent_last_pu=state.v_agent_pu,
        current_sq_pu=current_sq,
        backlog_kws=dc.backlog_kws,
        f_mhz=f_mhz,
        f_last_mhz=state.f_mhz,
        arrived_kw=dc.arrived_kw,
        served_kw=dc.served_kw,
        p_kw=p_agent,
        q_kvar=q_agent,
        q_limit_kvar=q_limit,
        class_backlog_kws=dc.class_backlog_kws,
        class_arrived_kw=dc.class_arrived_kw,
        class_served_kw=dc.class_served_kw,
    ), solution


def _to_nodes(values: Array, nodes: Array) -> Array:
    """Each agent's power in equal parts at its nodes, (lane, n_agent, n_node)."""
    if nodes.shape[-1] == 1:
        return values[..., None]
    return namespace(values).broadcast_to((values / nodes.shape[-1])[..., None], nodes.shape)


def from_nodes(v_pu: Array, nodes: Array) -> Array:
    """Each agent's voltage, the mean of its nodes', (lane, n_agent)."""
    at = take_at(v_pu, nodes)
    return at[..., 0] if nodes.shape[-1] == 1 else at.sum(-1) / nodes.shape[-1]
