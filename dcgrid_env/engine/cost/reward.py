"""The cost of a step: one definition for reward, tuning, hindsight and score.

    c_t = 100 mean|V-1| + 1000 mean max(|V-1| - 0.05, 0) + 0.3 sum(backlog)/sum(p_rated) + 0.02 mean(|q|/s_rated)
    J   = (1/T) sum_t c_t + 9 (1/T) sum(backlog_T)/sum(p_rated)

Means are over the nodes other than the substation's, and over agents. The first |V - 1| is another deviation where the
scenario has another reference, see ``scenario.costs.voltage_reference``. reward_t is minus its share of J times T. All
terms of the grid are in ``scenario.costs.grid_terms``; devices bring theirs.
"""

from __future__ import annotations

import operator
from collections import namedtuple
from functools import cache, reduce
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, all_true, as_like, namespace, sum_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.coverage import Coverage
from dcgrid_env.devices import CostTerm
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.devices.ratings import read_only
from dcgrid_env.engine.physics.dynamics import device_slices
from dcgrid_env.engine.physics.parameters import inverse, parameters
from dcgrid_env.engine.physics.state import State, VoltageFigures
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.scenario.cost import Cost
from dcgrid_env.scenario.costs.grid_terms import TERMS, GridTerm, Step, voltage_cost
from dcgrid_env.scenario.costs.voltage_reference import beyond_band, voltage_deviation
from dcgrid_env.scenario.scenario import Scenario

Costs = Any
"""Weighted terms of a step's cost by name, a named tuple: each of shape (row,) for the team or (row, n_agent) for each
agent. ``leftover`` and other terms that are charged at the end are 0 before an episode's last step."""
FROM_FIGURES = Coverage(
    {
        Cost: """
            weights* band_pu voltage reference profile_pu* profile_band_pu reward default_action default_gains
            ramp_limit_kw_per_s ramp_window_s voltage_step_limit_pu
        """
    }
)
"""Costs whose violation, and whose voltage cost if its form and reference are the default, are sums over the nodes that
come with the power flow (``VoltageFigures``). Others are computed from the voltages."""


@cached_on_owner
def _is_from_figures(scenario: Scenario) -> bool:
    return FROM_FIGURES.includes(scenario.cost)


def _step(
    scenario: Scenario,
    state: State,
    solution: Any,
    figures: VoltageFigures | None = None,
    nodes: Array | None = None,
) -> Step:
    t, v_pu, cost = terms(scenario), state.v_pu, scenario.cost
    figures = figures if _is_from_figures(scenario) else None
    if figures is not None and cost.voltage == "l1" and cost.reference == "nominal":
        voltage = figures.deviation_pu
    else:
        deviation = voltage_deviation(scenario, v_pu[..., t.judged], t.judged)
        voltage = sum_last(voltage_cost(cost.voltage, deviation, cost.band_pu))
    if figures is not None:
        excess = figures.excess_pu
    else:
        excess = sum_last(beyond_band(v_pu[..., t.judged] - 1.0, cost.band_pu))
    params = parameters(scenario, v_pu)
    return Step(scenario, state, solution, params, t.judged, t.n_judged, t.n_converters, voltage, excess, nodes)


def team_costs(
    scenario: Scenario, state: State, solution: Any, last: Array, figures: VoltageFigures | None = None
) -> Costs:
    """The terms of c_t after a step, (row,) each. Terms of the end are charged where ``last`` (bool) is True.

    ``figures`` of its voltages (``VoltageFigures``) are used if they are given.
    """
    t, step = terms(scenario), _step(scenario, state, solution, figures)
    costs = [zero := 0.0 * solution.loss_kw] * len(t.kind._fields)
    for place, amount, factor in t.of_grid:
        costs[place] = amount(step) * factor
    for i, amount, team_scale, of_amount in t.shares:
        share = sum_last(scenario.devices[i].amount(amount, step.params.devices[i], state.devices[i])) / team_scale
        for weight, at_end, place in of_amount:
            due = share * weight * last if at_end else share * weight
            costs[place] = due if costs[place] is zero else costs[place] + due
    return t.kind._make(costs)


def local_costs(scenario: Scenario, state: State, solution: Any, last: Array, nodes: Array | None = None) -> Costs:
    """Each agent's terms, (row, n_agent): its own voltage, effort, and what its device is charged for.

    Terms that no agent causes alone, such as the loss of the feeder, are charged to all alike. ``nodes`` of the agents,
    as in ``Exogenous.nodes``, are needed if the cost has a voltage profile.
    """
    xp, t, step = namespace(state.v_pu), terms(scenario), _step(scenario, state, solution, nodes=nodes)
    costs = [zero := 0.0 * state.v_agent_pu] * len(t.kind._fields)
    for (term, weight), (place, amount, factor) in zip(charged_terms(scenario), t.of_grid, strict=True):
        if term.of_agents is None:
            costs[place] = zero + (amount(step) * factor)[..., None]
        else:
            costs[place] = term.of_agents(step) * weight
    for i, term, weight, place in t.charged:
        cut = device_slices(scenario)[i]
        amount = scenario.devices[i].amount(term.amount, step.params.devices[i], state.devices[i])
        of_device = amount / as_like(term.own_scale, amount) * weight
        of_device = of_device * last[..., None] if term.at_end else of_device
        costs[place] = costs[place] + xp.concat((zero[..., : cut.start], of_device, zero[..., cut.stop :]), axis=-1)
    return t.kind._make(costs)


class Terms(NamedTuple):
    """The cost terms of a scenario."""

    kind: type[Any]
    """A named tuple with the terms of the grid that the scenario has, and then those of its devices."""
    of_grid: tuple[tuple[int, Any, float], ...]
    """Place and amount of the grid's terms that have a weight, and the weight over the divisor."""
    charged: tuple[tuple[int, CostTerm, float, int], ...]
    """Position of the device, term, weight and place among the terms, of those that have a weight; by amount."""
    shares: tuple[tuple[int, str, float, tuple[tuple[float, bool, int], ...]], ...]
    """These terms by amount: position of the device, amount, the scale of all its slots together, and of each term
    the weight, whether it is charged at the end, and the place."""
    constraints: tuple[int, ...]
    """Places of the terms that are constraints, the violation first."""
    judged: slice
    """Nodes whose voltages are charged, and their number."""
    n_judged: int
    n_converters: int
    """Number of agents with a converter, over which effort is a mean: all but equipment of the feeder."""


@cached_on_owner
def terms(scenario: Scenario) -> Terms:
    """The cost terms of a scenario."""
    weights = scenario.cost.weights._asdict()
    of_devices = [
        (i, term, weights.get(term.name, term.weight or 0.0))
        for i, device in enumerate(scenario.devices)
        for term in device.cost_terms(scenario.horizon, scenario.dt_s)
    ]
    of_grid = (term.name for term in TERMS if _is_listed(scenario, term))
    names = tuple(dict.fromkeys((*of_grid, *(term.name for _, term, _ in of_devices))))
    place = names.index
    of_devices.sort(key=lambda entry: (entry[0], entry[1].amount))
    charged = tuple((i, term, weight, place(term.name)) for i, term, weight in of_devices if weight)
    by_amount = groupby(charged, lambda entry: (entry[0], entry[1].amount, entry[1].team_scale))
    shares = tuple(
        (*key, tuple((weight, term.at_end, place) for _, term, weight, place in group)) for key, group in by_amount
    )
    constraints = {term.name for term in (*TERMS, *(term for _, term, _ in of_devices)) if term.is_constraint}
    judged, n_judged = scenario.feeder.load_slice, len(scenario.feeder.load_nodes)
    n_converters = max(sum(device.count for device in scenario.devices if not is_equipment(device)), 1)
    zero = np.zeros(1)
    fixed = Step(scenario, None, None, parameters(scenario, zero), judged, n_judged, n_converters, zero, zero)
    grid = tuple((place(t.name), t.amount, weight / t.divisor(fixed)) for t, weight in charged_terms(scenario))
    listed = tuple(place(name) for name in names if name in constraints)
    return Terms(_costs(names), grid, charged, shares, listed, judged, n_judged, n_converters)


class CostPrices(NamedTuple):
    """What a unit costs in a step, for controllers and comparisons of actions."""

    voltage: float
    """Deviation of a node's voltage from its reference, 1/p.u."""
    violation: float
    """Excess of a node's voltage over the band, 1/p.u."""
    effort: np.ndarray
    """Reactive power of each agent, 1/kvar, (n_agent,); 0 without a converter."""
    backlog: float
    """Queued work, 1/(kW s)."""
    leftover: float
    """Work queued at the end of the episode, 1/(kW s)."""


@cached_on_owner
def cost_prices(scenario: Scenario) -> CostPrices:
    """Return the cost of a unit of deviation, reactive power and waiting work."""
    t, weights = terms(scenario), scenario.cost.weights
    effort = (weights.effort / t.n_converters) * inverse(parameters(scenario, np.empty(0)).converter_kva)
    rated_kw = float(scenario.datacenters.parameters.p_rated_kw.sum()) or 1.0
    of_nodes = weights.voltage / t.n_judged, weights.violation / t.n_judged
    return CostPrices(*of_nodes, read_only(effort), weights.backlog / rated_kw, weights.leftover / rated_kw)


def _is_listed(scenario: Scenario, term: GridTerm) -> bool:
    if not term.is_always_listed:
        return bool(getattr(scenario.cost.weights, term.name))
    return not term.needs or isinstance(scenario.feeder, ThreePhaseFeeder)


@cached_on_owner
def charged_terms(scenario: Scenario) -> tuple[tuple[Any, float], ...]:
    """Terms of the grid that have a weight, with it."""
    weights = [(term, getattr(scenario.cost.weights, term.name)) for term in TERMS if term.amount is not None]
    return tuple((term, weight) for term, weight in weights if weight)


@cache
def _costs(names: tuple[str, ...]) -> Any:
    kind: Any = namedtuple("Costs", names)
    kind.__reduce__ = lambda costs: (_rebuilt, (names, tuple(costs)))  # a pickle finds no class of this name
    return kind


def _rebuilt(names: tuple[str, ...], values: tuple[Array, ...]) -> Costs:
    return _costs(names)._make(values)


def total(costs: Costs) -> Array:
    """Sum of the terms: of charged ones, the step's share of J times T."""
    return reduce(operator.add, costs)


def constraint(scenario: Scenario, costs: Costs) -> Array:
    """Cost that a constrained learner keeps below its budget: the violation, what is charged of limits, and trips."""
    places = terms(scenario).constraints
    return costs[places[0]] if len(places) == 1 else reduce(operator.add, [costs[place] for place in places])


def largest_costs(scenario: Scenario) -> Costs:
    """An upper bound of each term, as floats. A step is charged these if the power flow has no solution.

    The bounds of the grid's terms are in their records; devices state theirs.
    """
    t = terms(scenario)
    largest = dict.fromkeys(t.kind._fields, 0.0)
    for _, term, weight, _ in t.charged:
        largest[term.name] += weight * term.largest
    for term, weight in charged_terms(scenario):
        largest[term.name] += weight * term.largest(scenario)
    return t.kind(**largest)


def charged(scenario: Scenario, costs: Costs, step: Array, converged: Array) -> Costs:
    """The terms as they are charged at each row's ``step`` (1 .. horizon), (row,) int.

    Where the power flow has no solution the episode ends here, and this step and all that would have followed are
    charged at the largest cost, so that ending early never pays.
    """
    xp = namespace(converged)
    if all_true(converged):
        return costs
    remaining = xp.astype(scenario.horizon - step + 1, costs.voltage.dtype)
    at_end = {term.name for _, term, _, _ in terms(scenario).charged if term.at_end} | {"leftover"}
    largest = largest_costs(scenario)._asdict()
    due = [worst + 0 * remaining if name in at_end else worst * remaining for name, worst in largest.items()]

    def choose(a: Array, b: Array) -> Array:
        return xp.where(converged, a, b) if a.ndim == 1 else xp.where(converged[..., None], a, b[..., None])

    return type(costs)._make(map(choose, costs, due))


def end_costs(scenario: Scenario, state: State) -> dict[str, Array]:
    """Weighted terms that an episode's last step alone is charged, as if a state were behind that step.

    By term, (row,) each, those that devices bring and that have a weight; arrays of the state's kind, with its
    derivatives.
    """
    params, due = parameters(scenario, state.v_pu), {}
    for i, term, weight, _ in terms(scenario).charged:
        if term.at_end:
            amount = sum_last(scenario.devices[i].amount(term.amount, params.devices[i], state.devices[i]))
            share = amount / term.team_scale * weight
            due[term.name] = due[term.name] + share if term.name in due else share
    return due
