"""The cost of a step: one definition for reward, tuning, hindsight and score.

    c_t = 100 mean|V-1| + 1000 mean max(|V-1| - 0.05, 0) + 0.3 sum(backlog)/sum(p_rated) + 0.02 mean|q|/q_rating
    J   = (1/T) sum_t c_t + 9 (1/T) sum(backlog_T)/sum(p_rated)

means over buses other than the substation, and over agents. reward_t is minus its share of J times T. Three more
terms have weight 0 by default: ``step`` is mean|V_t - V_{t-1}|, ``clock`` the mean movement of the clocks as a share of
their range, ``loss`` the feeder's loss as a share of its base load and the data centres' ratings. On a three-phase
feeder means are over nodes, and there are two more terms at weight 0: ``unbalance``, the mean over three-phase buses of
the squared voltage unbalance factor, taken as 1 at most, and ``switching``, the mean number of taps and switchings over
the regulators and capacitor banks that are not fixed. Where they have a weight there are ``ramp_excess``, the mean over
sites, and ``voltage_step_excess``, the mean over buses, of what exceeds a utility's limit (see ``utility_limits``),
and ``overload``, the mean over branches of what exceeds their ratings (see ``overload``).
"""

from __future__ import annotations

import math
from collections import namedtuple
from functools import cache
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, all_true, as_like, namespace, positive_part, sum_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices import CostTerm
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.engine.dynamics import device_slices
from dcgrid_env.engine.equipment import largest_mean_switching, mean_controlled_switching, mean_switching
from dcgrid_env.engine.overload import MOST_EXCESS, mean_overload
from dcgrid_env.engine.parameters import parameters
from dcgrid_env.engine.state import State
from dcgrid_env.engine.utility_limits import (
    largest_ramp_excess,
    largest_voltage_step_excess,
    ramp_excess,
    sites,
    voltage_step_excess,
)
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.scenario.cost import LIMIT_OF
from dcgrid_env.scenario.scenario import Scenario


class Costs(NamedTuple):
    """Weighted terms of a step's cost, each of shape (lane,) for the team or (lane, n_agent) for each agent alone."""

    voltage: Array
    violation: Array
    backlog: Array
    effort: Array
    clock: Array
    step: Array
    loss: Array
    leftover: Array
    """Charged once, after an episode's last step."""


VOLTAGE, VIOLATION, EFFORT, STEP, LOSS = map(Costs._fields.index, ("voltage", "violation", "effort", "step", "loss"))
"""Places of the grid's own terms, so that a step builds its costs without looking names up."""
UNBALANCE, SWITCHING = OF_THREE_PHASES = ("unbalance", "switching")
"""The terms of the grid that a three-phase feeder alone has."""
RAMP, VOLTAGE_STEP, OVERLOAD = OF_LIMITS = (*LIMIT_OF, "overload")
"""The terms that charge what exceeds a limit, or a branch's rating, which are there where they have a weight."""


def voltage_cost(kind: str, deviation: Array, band_pu: float) -> Array:
    """Cost of a voltage ``deviation`` = |V - 1|, p.u., elementwise, unweighted.

    The five of MAPDN (J. Wang et al., "Multi-agent reinforcement learning for active voltage control on power
    distribution networks", NeurIPS 2021, arXiv 2110.14300): ``l1`` and ``l2``; ``bowl``, a normal density's hollow
    within 0.05 p.u. and a line beyond it; ``courant_beltrami``, squared excess over the band; ``bump``, the smooth bump
    function of 1 - deviation. Constant factors that its code puts before some of them are left to the weight.
    """
    xp = namespace(deviation)
    if kind == "l1":
        return deviation
    if kind == "l2":
        return deviation * deviation
    if kind == "courant_beltrami":
        excess = positive_part(deviation - band_pu)
        return excess * excess
    if kind == "bowl":
        sigma = 0.1
        density = xp.exp(-0.5 * (deviation / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
        return xp.where(deviation > 0.05, 2.0 * deviation - 0.095, 0.04 - 0.01 * density)
    if kind != "bump":
        raise ValueError(f"voltage cost {kind!r} is none of l1, l2, bowl, courant_beltrami, bump")
    near = 1.0 - (1.0 - deviation) ** 4  # bump: 0 at V = 1 and again at deviation 2, where the exponent has its poles
    inside = (deviation > 0.0) & (deviation < 2.0)
    return xp.where(inside, xp.exp(-1.0 / xp.where(inside, near, 1.0 + 0.0 * near)), 0.0 * near)


def team_costs(scenario: Scenario, state: State, solution: Any, last: Array, figures: Any = None) -> Costs:
    """The terms of c_t after a step, (lane,) each; what is charged at the end is where ``last`` (bool) is True.

    ``figures`` of its voltages (``VoltageFigures``) are used if they are given.
    """
    xp, w, params, t = namespace(state.v_pu), scenario.weights, parameters(scenario, state.v_pu), terms(scenario)
    deviation, excess = _voltage_sums(scenario, state.v_pu, t.judged, figures)
    costs = [none := 0.0 * solution.loss_kw] * len(t.kind._fields)
    costs[VOLTAGE] = deviation * (w.voltage / t.n_judged)
    costs[VIOLATION] = excess * (w.violation / t.n_judged)
    costs[EFFORT] = sum_last(xp.abs(state.q_kvar) / params.converter_kva) * (w.effort / t.n_converters)
    if w.step:
        change = xp.abs(state.v_pu[..., t.judged] - state.v_last_pu[..., t.judged])
        costs[STEP] = sum_last(change) * (w.step / t.n_judged)
    if w.loss:
        costs[LOSS] = solution.loss_kw * (w.loss / params.p_all_kw)
    if state.three_phase is not None and w.unbalance:
        costs[t.kind._fields.index(UNBALANCE)] = _mean_unbalance(state.three_phase.unbalance) * w.unbalance
    if state.three_phase is not None and w.switching:
        moves = mean_switching(scenario, state.three_phase.equipment) * w.switching
        costs[t.kind._fields.index(SWITCHING)] = none + moves
    if w.ramp_excess:
        over = ramp_excess(scenario, state)
        costs[t.kind._fields.index(RAMP)] = sum_last(over) * (w.ramp_excess / over.shape[-1])
    if w.voltage_step_excess:
        over = voltage_step_excess(scenario, state.v_pu[..., t.judged], state.v_last_pu[..., t.judged])
        costs[t.kind._fields.index(VOLTAGE_STEP)] = sum_last(over) * (w.voltage_step_excess / t.n_judged)
    if w.overload:
        costs[t.kind._fields.index(OVERLOAD)] = mean_overload(scenario, state.loading) * w.overload
    for i, amount, team_scale, of_amount in t.shares:
        share = sum_last(scenario.devices[i].amount(amount, params.devices[i], state.devices[i])) / team_scale
        for weight, at_end, at in of_amount:
            due = share * weight * last if at_end else share * weight
            costs[at] = due if costs[at] is none else costs[at] + due
    return t.kind._make(costs)


def _voltage_sums(scenario: Scenario, v_pu: Array, judged: slice, figures: Any) -> tuple[Array, Array]:
    """Sum over the judged nodes of the voltage cost and of what lies beyond the band, (lane,) each."""
    kind, band_pu = scenario.voltage_cost, scenario.band_pu
    if kind == "l1" and figures is not None:
        return figures.deviation_pu, figures.excess_pu
    deviation = namespace(v_pu).abs(v_pu[..., judged] - 1.0)
    return sum_last(voltage_cost(kind, deviation, band_pu)), sum_last(positive_part(deviation - band_pu))


def _mean_unbalance(factor: Array) -> Array:
    """Mean of the squared voltage unbalance factor over three-phase buses, (lane,)."""
    n = factor.shape[-1]
    return sum_last(1.0 - positive_part(1.0 - factor * factor)) / max(n, 1)


def local_costs(scenario: Scenario, state: State, solution: Any, last: Array) -> Costs:
    """Each agent's terms alone, (lane, n_agent): its own voltage, effort, and what its device is charged for.

    The feeder's loss, unbalance and overload are nobody's own and are charged to all alike.
    """
    xp, w, params = namespace(state.v_pu), scenario.weights, parameters(scenario, state.v_pu)
    deviation = xp.abs(state.v_agent_pu - 1.0)
    none = 0.0 * deviation
    costs = terms(scenario).kind(
        voltage=voltage_cost(scenario.voltage_cost, deviation, scenario.band_pu) * w.voltage,
        violation=positive_part(deviation - scenario.band_pu) * w.violation,
        effort=xp.abs(state.q_kvar) / params.converter_kva * w.effort,
        step=xp.abs(state.v_agent_pu - state.v_agent_last_pu) * w.step,
        loss=none + (solution.loss_kw * (w.loss / params.p_all_kw))[..., None],
        **dict.fromkeys(terms(scenario).names, none),
    )
    if state.three_phase is not None and w.unbalance:
        of_all = _mean_unbalance(state.three_phase.unbalance) * w.unbalance
        costs = costs._replace(**{UNBALANCE: none + of_all[..., None]})
    if state.three_phase is not None and w.switching:
        moved = _own_switching(scenario, state, state.three_phase.equipment, none)
        costs = costs._replace(**{SWITCHING: moved * w.switching})
    if w.ramp_excess:
        cut, own = sites(scenario), ramp_excess(scenario, state) * w.ramp_excess
        costs = costs._replace(**{RAMP: xp.concat((none[..., : cut.start], own, none[..., cut.stop :]), axis=-1)})
    if w.voltage_step_excess:
        own = voltage_step_excess(scenario, state.v_agent_pu, state.v_agent_last_pu) * w.voltage_step_excess
        costs = costs._replace(**{VOLTAGE_STEP: own})
    if w.overload:
        costs = costs._replace(**{OVERLOAD: none + (mean_overload(scenario, state.loading) * w.overload)[..., None]})
    for i, term, weight, _ in terms(scenario).charged:
        cut = device_slices(scenario)[i]
        amount = scenario.devices[i].amount(term.amount, params.devices[i], state.devices[i])
        own = amount / as_like(term.own_scale, amount) * weight
        own = own * last[..., None] if term.at_end else own
        widened = xp.concat((none[..., : cut.start], own, none[..., cut.stop :]), axis=-1)
        costs = costs._replace(**{term.name: getattr(costs, term.name) + widened})
    return costs


def _own_switching(scenario: Scenario, state: State, equipment: Any, none: Array) -> Array:
    """Each agent's own moves, and what the controls of equipment move, which is nobody's own, (lane, n_agent)."""
    of_all = none + mean_controlled_switching(scenario, equipment)[..., None]
    parts = [
        none[..., cut] if not is_equipment(device) else getattr(own, "moved" if hasattr(own, "moved") else "switched")
        for device, own, cut in zip(scenario.devices, state.devices, device_slices(scenario), strict=True)
    ]
    return of_all + namespace(none).concat(parts, axis=-1)


class Terms(NamedTuple):
    """The cost terms of a scenario."""

    kind: Any
    """Costs, or a named tuple like it with the terms of its devices that Costs does not have behind its own."""
    names: tuple[str, ...]
    """Terms that devices bring, those of ``Costs`` whether a device of the scenario brings them or not."""
    charged: tuple[tuple[int, CostTerm, float, int], ...]
    """Position of the device, term, weight and place among the terms, of those that have a weight; by amount."""
    shares: tuple[tuple[int, str, float, tuple[tuple[float, bool, int], ...]], ...]
    """These terms by amount: position of the device, amount, the scale of all its slots together, and of each term
    the weight, whether it is charged at the end, and the place."""
    judged: slice
    """Nodes whose voltages are charged, and their number."""
    n_judged: int
    n_converters: int
    """Number of agents with a converter, over which effort is a mean: all but equipment of the feeder."""


@cached_on_owner
def terms(scenario: Scenario) -> Terms:
    """The cost terms of a scenario."""
    weights = scenario.weights._asdict()
    own_terms = [
        (i, term, weights.get(term.name, term.weight or 0.0))
        for i, device in enumerate(scenario.devices)
        for term in device.cost_terms(scenario.horizon, scenario.dt_s)
    ]
    of_grid = OF_THREE_PHASES if isinstance(scenario.feeder, ThreePhaseFeeder) else ()
    of_limits = tuple(name for name in OF_LIMITS if weights[name])
    names = (*of_grid, *of_limits, *(term.name for _, term, _ in own_terms))
    more = tuple(dict.fromkeys(name for name in names if name not in Costs._fields))
    kind = _costs(more)
    own_terms.sort(key=lambda entry: (entry[0], entry[1].amount))
    charged = tuple((i, term, weight, kind._fields.index(term.name)) for i, term, weight in own_terms if weight)
    by_amount = groupby(charged, lambda entry: (entry[0], entry[1].amount, entry[1].team_scale))
    shares = tuple((*key, tuple((weight, term.at_end, at) for _, term, weight, at in own)) for key, own in by_amount)
    judged, n_judged = scenario.feeder.load_slice, len(scenario.feeder.load_nodes)
    n_converters = sum(device.count for device in scenario.devices if not is_equipment(device))
    return Terms(kind, ("backlog", "clock", "leftover", *more), charged, shares, judged, n_judged, max(n_converters, 1))


@cache
def _costs(more: tuple[str, ...]) -> Any:
    return namedtuple("Costs", (*Costs._fields, *more)) if more else Costs


def total(costs: Costs) -> Array:
    """Sum of the terms: of charged ones, the step's share of J times T."""
    c = costs
    whole = c.voltage + c.violation + c.backlog + c.effort + c.clock + c.step + c.loss + c.leftover
    return whole if type(c) is Costs else sum(c[len(Costs._fields) :], whole)


def largest_costs(scenario: Scenario) -> Costs:
    """An upper bound of each term, as floats: what a step is charged once the power flow has no solution.

    Voltage anywhere from 0 to 2 p.u., full effort, voltage swinging from end to end, twice all that is drawn lost (a
    feeder at its limit loses about as much as it delivers), sites as far above their ratings as the scenario lets them,
    and of each device's terms what it says: all work of the episode queued, the clock swinging from end to end.
    """
    w = scenario.weights
    farthest = np.ones(1)  # the deviation at which every voltage cost is largest
    of_devices = dict.fromkeys(terms(scenario).names, 0.0)
    for _, term, weight, _ in terms(scenario).charged:
        of_devices[term.name] += weight * term.largest
    if UNBALANCE in of_devices:
        of_devices[UNBALANCE] += w.unbalance
        of_devices[SWITCHING] += w.switching * largest_mean_switching(scenario)
    if w.ramp_excess:
        of_devices[RAMP] += w.ramp_excess * largest_ramp_excess(scenario)
    if w.voltage_step_excess:
        of_devices[VOLTAGE_STEP] += w.voltage_step_excess * largest_voltage_step_excess(scenario)
    if w.overload:
        of_devices[OVERLOAD] += w.overload * MOST_EXCESS
    return terms(scenario).kind(
        voltage=w.voltage * float(voltage_cost(scenario.voltage_cost, farthest, scenario.band_pu)[0]),
        violation=w.violation * (1.0 - scenario.band_pu),
        effort=w.effort,
        step=w.step,
        loss=2.0 * w.loss * max(device.largest_draw_share for device in scenario.devices),
        **of_devices,
    )


def charged(scenario: Scenario, costs: Costs, step: Array, converged: Array) -> Costs:
    """The terms as they are charged at each lane's ``step`` (1 .. horizon), (lane,) int.

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
