"""Difference rewards: how much of a step's cost each action saves, compared with a default action.

The saved cost of an entry of the joint action is the team's cost of the step with that entry alone replaced by the
default, less its cost as it was. It is a difference reward (D. Wolpert and K. Tumer, "Optimal payoff functions for
members of collectives", Advances in Complex Systems 4, 2001), for each channel of an agent. With the policy's mean as
the default it would be close to the advantage in J. Foerster et al., "Counterfactual multi-agent policy gradients",
arXiv 1705.08926.

    saved(a) = c(V + dV) - c(V) + w_effort (|q'|/s - |q|/s) + w_request (missed(P') - missed(P))
               + sum over a's terms of price (amount' - amount)
    dV       = (dV/dq (q' - q) - dV/dp (p' - p)) / V           balanced; without 1/V on a three-phase feeder

A dash marks the step with the default in that entry. The devices' own ``step`` computes p' and amount', so routed work
and storage are included, and the converter limits q' at p'. dV/dp and dV/dq are the sensitivities of the feeder
(LinDistFlow, or the three-phase feeder linearised at its base loads), for power that is injected.

``price`` is the weight of a term, and of one charged at the end of the episode too. Deferred work is therefore charged
at once, with the price of its waiting in this step and that of work left at the end. This is a bias: it assumes
a fixed waiting time. Useful taps of regulators are paid in advance (``tap_credit``). All other effects on later steps
are neglected.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.coverage import Coverage
from dcgrid_env.devices import DataCenters, Q, converter, site_work
from dcgrid_env.engine.cost.reward import cost_prices, terms
from dcgrid_env.engine.cost.tap_credit import ComingTaps, TapTargets, coming_taps
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.physics.connections import connections, true_sensitivity
from dcgrid_env.engine.physics.dynamics import device_slices, device_step
from dcgrid_env.engine.physics.parameters import parameters
from dcgrid_env.engine.physics.state import Exogenous, State
from dcgrid_env.grid import Feeder
from dcgrid_env.grid.random_feeders.feeder_batch import FeederBatch
from dcgrid_env.powerflow import sensitivity
from dcgrid_env.scenario.cost import Cost
from dcgrid_env.scenario.costs import load_requests
from dcgrid_env.scenario.costs.grid_terms import voltage_cost
from dcgrid_env.scenario.costs.utility_limits import sites
from dcgrid_env.scenario.costs.voltage_reference import beyond_band, voltage_deviation, voltage_targets
from dcgrid_env.scenario.scenario import Scenario

COVERED = Coverage(
    {
        Cost: """
            weights* band_pu reference profile_pu* profile_band_pu reward default_action default_gains
            ramp_limit_kw_per_s ramp_window_s voltage_step_limit_pu
        """
    }
)
"""Costs that the kernel covers: those with the default form of the voltage cost."""


class Sensitivities(NamedTuple):
    """Sensitivities of a scenario's feeder to power at each group of nodes of ``connections``, in equal shares."""

    by_p: np.ndarray
    """dV/dp of the charged nodes, p.u. per kW injected, (n_group, n_charged)."""
    by_q: np.ndarray
    """dV/dq likewise, p.u. per kvar."""
    is_squared: bool
    """Whether the sensitivities are those of half the squared voltage, as in LinDistFlow."""


@cached_on_owner
def sensitivities(scenario: Scenario) -> Sensitivities:
    """Return the sensitivities of a scenario's feeder; of a batch of feeders, those of one after the other."""
    feeder, charged = scenario.feeder, scenario.feeder.load_slice
    if isinstance(feeder, FeederBatch):
        of_feeders = [[matrix[charged].T / 1e3 for matrix in sensitivity(member)] for member, _ in feeder.members]
        by_p, by_q = (np.concatenate(matrices) for matrices in zip(*of_feeders, strict=True))
        return Sensitivities(by_p, by_q, True)
    nodes = connections(scenario).nodes
    by_p, by_q = (matrix[charged].T[nodes].mean(1) / 1e3 for matrix in true_sensitivity(scenario))
    return Sensitivities(by_p, by_q, isinstance(feeder, Feeder))


def groups(scenario: Scenario, buses: np.ndarray) -> np.ndarray:
    """Return the row of ``sensitivities`` of each agent at its bus, int, (row, n_agent)."""
    feeder = scenario.feeder
    if not isinstance(feeder, FeederBatch):
        return connections(scenario).group[np.arange(scenario.n_agents), buses]
    feeder_index = np.empty(len(buses), np.int64)
    for i, (_, env_indices) in enumerate(feeder.members):
        feeder_index[env_indices] = i
    return buses + feeder_index[:, None] * feeder.n_bus


@cached_on_owner
def rest_setpoints(scenario: Scenario) -> np.ndarray:
    """Return the set points at t = 0, (n_action,), each in the unit of its channel."""
    by_device = [
        np.stack([np.broadcast_to(channel.rest, (device.count,)) for channel in device.channels], axis=-1).ravel()
        for device in scenario.devices
        if device.count and device.channels
    ]
    return np.concatenate([np.empty(0), *by_device])


@cached_on_owner
def rest_action(scenario: Scenario) -> np.ndarray:
    """Return the joint action of ``rest_setpoints``, (n_action,); 0 for a channel without a range."""
    rest = rest_setpoints(scenario)
    params = parameters(scenario, rest)
    half = params.half_range
    return np.divide(rest - params.middle, half, out=np.zeros_like(rest), where=half > 0.0)


def default_setpoints(scenario: Scenario, state: State, p_ref_kw: np.ndarray) -> np.ndarray:
    """Return the set points of the default action, (row, n_action), each in the unit of its channel.

    Parameters
    ----------
    scenario
        The scenario; ``cost.default_action`` selects the default.
    state
        State before the step.
    p_ref_kw
        Draw of the sites over the step at the highest clock without a queue, kW, (row, n_site).
    """
    rest, kind = rest_setpoints(scenario), scenario.cost.default_action
    default = np.empty((len(state.v_pu), len(rest)))
    default[:] = rest
    if kind == "rest":
        return default
    q_kvar, has_q = state.q_kvar, scenario.q_scale_kvar > 0.0
    if kind == "droop":
        k_p, k_q, alpha_per_s = scenario.cost.default_gains
        q_kvar = q_kvar - 1e3 * k_q * scenario.dt_s * (state.v_agent_pu - 1.0)
        q_kvar = np.clip(q_kvar, -scenario.q_scale_kvar, scenario.q_scale_kvar)
        _set_clocks(scenario, state, p_ref_kw, k_p, alpha_per_s, default)
    default[:, parameters(scenario, default).reactive[has_q]] = q_kvar[:, has_q]
    return default


def _set_clocks(
    scenario: Scenario, state: State, p_ref_kw: np.ndarray, k_p: float, alpha_per_s: float, setpoints: np.ndarray
) -> None:
    """Set the clocks of data centres to those of the droop law, see ``baselines.laws.droop``."""
    first = 0
    for i, device in enumerate(scenario.devices):
        sites = slice(first, first + device.count)
        if isinstance(device, DataCenters) and device.count:
            cut, site = device_slices(scenario)[i], device.parameters
            more_kw = 1e3 * k_p * (state.v_agent_pu[:, cut] - 1.0) + alpha_per_s * state.devices[i].backlog_kws
            clocks = site.p_idle_kw, site.p_dynamic_kw, site.f_min_mhz, site.f_max_mhz
            f_mhz = site_work.clock_for(*clocks, p_ref_kw[:, sites] + more_kw)
            setpoints[:, action_layout(scenario).columns[i][0]] = f_mhz
        if device.input == "workload":
            first = sites.stop


class Changes(NamedTuple):
    """Changes of agents' powers that are compared: those of each entry of the joint action, one entry after the other.

    An entry changes the powers of one agent, or of all sites if these route work.
    """

    agent: np.ndarray
    """Agent whose powers change, (n_change,)."""
    first: np.ndarray
    """First change of each entry, and n_change, (n_action + 1,)."""
    is_reactive: np.ndarray
    """Whether the entry is a reactive set point, bool, (n_change,)."""
    reactive_entry: np.ndarray
    """Entry of the agent's reactive set point, (n_change,); any for an agent without one."""
    has_reactive: np.ndarray
    """1 for an agent with a reactive set point, else 0, (n_change,)."""


@cached_on_owner
def changes(scenario: Scenario) -> Changes:
    """Return the changes that are compared in a scenario."""
    layout, agents = action_layout(scenario), {agent: i for i, agent in enumerate(scenario.agents)}
    together = {
        scenario.agents[i]: range(cut.start, cut.stop)
        for device, cut in zip(scenario.devices, device_slices(scenario), strict=True)
        if _is_coupled(device)
        for i in range(cut.start, cut.stop)
    }
    changed = [
        [agents[agent]] if name == Q else list(together.get(agent, [agents[agent]])) for agent, name in layout.names
    ]
    counts = [len(of_entry) for of_entry in changed]
    agent = np.array([i for of_entry in changed for i in of_entry], np.int64)
    reactive = layout.reactive[agent]
    return Changes(
        agent, np.cumsum([0, *counts]), np.repeat(layout.is_channel(Q), counts), reactive.clip(0, None),
        (reactive >= 0).astype(np.float64),
    )  # fmt: skip


class Run(NamedTuple):
    """A repeated step of a group of devices with the default in one channel, of all slots or of one."""

    device: int
    channel: int
    """Position among the channels of the device without the reactive one."""
    slots: np.ndarray
    entries: np.ndarray
    """Entries of the joint action of these slots."""
    changes: np.ndarray
    """Changes that the draws of all slots are, in the order of ``Changes``."""
    is_coupled: bool


@cached_on_owner
def runs(scenario: Scenario) -> tuple[Run, ...]:
    """Return the repeated steps of a scenario: one for each channel, or one for each slot that acts on others."""
    layout, first, needed = action_layout(scenario), changes(scenario).first, []
    for i, columns in enumerate(layout.columns):
        coupled = _is_coupled(scenario.devices[i])
        for k, column in enumerate(columns):
            entries = np.arange(layout.n)[column]
            slots = np.arange(len(entries))
            for chosen in slots[:, None] if coupled else [slots]:
                together = np.arange(*first[entries[chosen[0]] :][:2]) if coupled else first[entries]
                needed.append(Run(i, k, chosen, entries[chosen], together, coupled))
    return tuple(needed)


def _is_coupled(device: Any) -> bool:
    """Return whether a set point of one slot acts on the others, because work is routed among them."""
    return getattr(device, "routing", None) is not None


def differences(
    scenario: Scenario,
    before: State,
    after: State,
    setpoints: np.ndarray,
    default: np.ndarray,
    exogenous: Exogenous,
    buses: np.ndarray,
    targets: TapTargets | None = None,
    steps_left: Any = None,
) -> np.ndarray:
    """Return the cost that each entry of the joint action saves in a step, (row, n_action); negative for a loss.

    Parameters
    ----------
    scenario
        A scenario that passes ``check_difference_reward``.
    before, after
        States before and after the step. Without a power-flow solution ``after`` contains the last voltages.
    setpoints, default
        Set points of the action and of the default action, (row, n_action), each in the unit of its channel.
    exogenous
        Exogenous inputs of the step.
    buses
        Position of each agent's bus in ``bus_ids``, (row, n_agent).
    targets, steps_left
        Useful taps, and the steps of the episode after this one, (row,); None where no tap is paid.
    """
    params, change, saved = parameters(scenario, default), changes(scenario), np.zeros(default.shape)
    drawn_kw = np.zeros((len(default), len(change.agent)))
    for run in runs(scenario):
        replaced = [setpoints[:, column] for column in action_layout(scenario).columns[run.device]]
        replaced[run.channel] = replaced[run.channel].copy()
        replaced[run.channel][:, run.slots] = default[:, run.entries]
        state, drawn_kw[:, run.changes] = device_step(scenario, params, before, run.device, tuple(replaced), exogenous)
        more = _more_charged(scenario, run.device, params, state, after.devices[run.device])
        saved[:, run.entries] = more.sum(-1, keepdims=True) if run.is_coupled else more
    slopes, taps_ahead = _NO_SLOPES, _NO_TAPS
    if targets is not None:
        slopes = (targets.by_p, targets.by_q)
        taps_ahead = coming_taps(scenario, targets, after, steps_left, exogenous.offset_v)
    group = groups(scenario, buses)
    add_saved_costs(scenario, after, setpoints, default, drawn_kw, exogenous, group, slopes, taps_ahead, saved)
    if scenario.cost.weights.grid_request:
        saved += _saved_requests(scenario, after, drawn_kw, exogenous.available)
    return saved


_NO_SLOPES = (np.empty((0, 0)), np.empty((0, 0)))
_NO_TAPS = ComingTaps(np.empty((0, 0)), np.empty(0), np.empty((0, 0)))


def sums_by_agent(scenario: Scenario, of_entries: np.ndarray) -> np.ndarray:
    """Return the sum of each agent's entries, (row, n_agent), of values (row, n_action)."""
    return of_entries @ _owners(scenario)


@cached_on_owner
def _owners(scenario: Scenario) -> np.ndarray:
    """1 where an entry of the joint action belongs to an agent, else 0, (n_action, n_agent)."""
    layout = action_layout(scenario)
    return np.array([[owner == agent for agent in scenario.agents] for owner, _ in layout.names], np.float64)


def _more_charged(scenario: Scenario, i: int, params: Any, state: Any, now: Any) -> Any:
    """Return what ``state`` charges the team for each slot of a device beyond what ``now`` does, (row, slot).

    What is charged at the end of the episode counts at once.
    """
    total: Any = np.zeros((1, scenario.devices[i].count))
    for amount, price in _prices(scenario)[i]:
        of_slots, of_now = (scenario.devices[i].amount(amount, params.devices[i], each) for each in (state, now))
        total = total + price * (of_slots - of_now)
    return total


@cached_on_owner
def _prices(scenario: Scenario) -> tuple[tuple[tuple[str, float], ...], ...]:
    """Return the charged amounts of each device with their prices."""
    shares = terms(scenario).shares
    return tuple(
        tuple(
            (amount, sum(weight for weight, _, _ in charged) / scale)
            for position, amount, scale, charged in shares
            if position == i
        )
        for i in range(len(scenario.devices))
    )


class Charges(NamedTuple):
    """Constants of the costs that are compared."""

    targets_pu: np.ndarray
    """Voltage that each charged node should have, p.u., (n_charged,)."""
    voltage: float
    violation: float
    """Weight of a node's deviation beyond ``uncharged_pu`` and ``band_pu``, 1/p.u."""
    effort: np.ndarray
    """Weight of each agent's reactive power, 1/kvar, (n_agent,)."""


@cached_on_owner
def charges(scenario: Scenario) -> Charges:
    """Return the constants of a scenario's costs."""
    targets, prices = voltage_targets(scenario)[..., terms(scenario).judged], cost_prices(scenario)
    if targets.ndim == 2:
        targets = targets[0]  # on several feeders all targets are 1 p.u., see check_difference_reward
    return Charges(np.ascontiguousarray(targets), prices.voltage, prices.violation, prices.effort)


@cached_on_owner
def has_kernel(scenario: Scenario) -> bool:
    """Return whether the kernel covers the cost; otherwise array operations compare it, and no taps are paid."""
    return COVERED.includes(scenario.cost)


def add_saved_costs(
    scenario: Scenario,
    state: State,
    setpoints: np.ndarray,
    default: np.ndarray,
    drawn_kw: np.ndarray,
    exogenous: Exogenous,
    group: np.ndarray,
    slopes: tuple[np.ndarray, np.ndarray],
    taps_ahead: ComingTaps,
    saved: np.ndarray,
) -> None:
    """Add the voltage, violation and effort costs that each entry saves to ``saved``, (row, n_action), and taps.

    Parameters
    ----------
    scenario, state
        The scenario and the state after the step.
    setpoints, default
        See ``differences``.
    drawn_kw
        Draws with the default, kW, (row, n_change), in the order of ``changes``; any for a reactive set point.
    exogenous
        Exogenous inputs of the step.
    group
        Group of nodes of each agent, (row, n_agent).
    slopes, coming
        Slopes of relay volts (``TapTargets.by_p``, ``by_q``) and worth of useful taps, without columns if none is paid.
    saved
        Array to add to.
    """
    if not has_kernel(scenario):
        saved += _saved_costs_arrays(scenario, state, setpoints, default, drawn_kw, exogenous, group)
        return
    from dcgrid_env.core.threads import over_rows  # brings the compiler with it, so not on import
    from dcgrid_env.engine.cost.difference_kernel import add_saved_costs_rows

    by, charged, change = sensitivities(scenario), charges(scenario), changes(scenario)
    cost, params = scenario.cost, parameters(scenario, default)
    available = np.empty((0, 0)) if exogenous.available is None else np.ascontiguousarray(exogenous.available)
    arguments = (
        np.ascontiguousarray(state.v_pu), group, by.by_p, by.by_q, by.is_squared, charged.targets_pu,
        float(cost.uncharged_pu), float(cost.band_pu), charged.voltage, charged.violation, charged.effort, *change,
        params.converter_kva, params.q_scale_kvar, setpoints, default, np.ascontiguousarray(state.p_kw),
        np.ascontiguousarray(state.q_kvar), drawn_kw, available, *slopes, *taps_ahead, saved,
    )  # fmt: skip
    over_rows(lambda begin, end: add_saved_costs_rows(begin, end, *arguments), len(saved))


def _saved_requests(scenario: Scenario, state: State, drawn_kw: np.ndarray, available: np.ndarray | None) -> np.ndarray:
    """Return the cost of the utility's requests that each entry saves, (row, n_action); see ``add_saved_costs``."""
    change, request, cut = changes(scenario), load_requests.columns(state.request), sites(scenario)
    is_draw = ~change.is_reactive & (change.agent >= cut.start) & (change.agent < cut.stop)
    p_kw = drawn_kw if available is None else drawn_kw * available[:, change.agent]
    moved_kw = np.add.reduceat(np.where(is_draw, p_kw - state.p_kw[:, change.agent], 0.0), change.first[:-1], axis=1)
    draw = load_requests.sites_share(scenario, state.p_kw)[:, None]
    with_default = draw + moved_kw / load_requests.rated_kw(scenario)
    lower, upper = request.lower[:, None], request.upper[:, None]
    more = load_requests.missed_share(with_default, lower, upper) - load_requests.missed_share(draw, lower, upper)
    return scenario.cost.weights.grid_request * more


def _saved_costs_arrays(
    scenario: Scenario,
    state: State,
    setpoints: np.ndarray,
    default: np.ndarray,
    drawn_kw: np.ndarray,
    exogenous: Exogenous,
    group: np.ndarray,
) -> np.ndarray:
    """What ``add_saved_costs`` adds without taps, as array operations and for every form of the voltage cost."""
    by, judged, cost, change = sensitivities(scenario), terms(scenario).judged, scenario.cost, changes(scenario)
    charged = charges(scenario)
    params, p_now, q_now = parameters(scenario, default), state.p_kw[:, change.agent], state.q_kvar[:, change.agent]
    p_kw = np.where(change.is_reactive, p_now, drawn_kw)
    requested_kvar = (
        np.where(change.is_reactive, default[:, change.reactive_entry], setpoints[:, change.reactive_entry])
        * change.has_reactive
    )
    q_kvar, _ = converter.dispatch(
        params.converter_kva[change.agent], params.q_scale_kvar[change.agent], p_kw, requested_kvar
    )
    if exogenous.available is not None:
        available = exogenous.available[:, change.agent]
        p_kw, q_kvar = p_kw * available, q_kvar * available
    by_p, by_q = by.by_p[group[:, change.agent]], by.by_q[group[:, change.agent]]
    moved = (q_kvar - q_now)[..., None] * by_q - (p_kw - p_now)[..., None] * by_p
    more = (np.abs(q_kvar) - np.abs(q_now)) * charged.effort[change.agent]
    moved, more = (np.add.reduceat(values, change.first[:-1], axis=1) for values in (moved, more))
    v = state.v_pu[:, None, judged]

    def costs(v_pu: np.ndarray) -> np.ndarray:
        deviation = voltage_cost(cost.voltage, voltage_deviation(scenario, v_pu, judged), cost.band_pu)
        beyond = beyond_band(v_pu - 1.0, cost.band_pu)
        return charged.voltage * deviation.sum(-1) + charged.violation * beyond.sum(-1)

    return costs(v + (moved / v if by.is_squared else moved)) - costs(v) + more
