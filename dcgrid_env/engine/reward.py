"""The cost of a step: one definition for reward, tuning, hindsight and score.

    c_t = 100 mean|V-1| + 1000 mean max(|V-1| - 0.05, 0) + 0.3 sum(backlog)/sum(p_rated) + 0.02 mean|q|/q_rating
    J   = (1/T) sum_t c_t + 9 (1/T) sum(backlog_T)/sum(p_rated)

means over buses other than the substation, and over agents. reward_t is minus its share of J times T. Three more
terms have weight 0 by default: ``step`` is mean|V_t - V_{t-1}|, ``clock`` the mean movement of the clocks as a share of
their range, ``loss`` the feeder's loss as a share of its base load and the data centres' ratings.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, all_true, namespace, positive_part, sum_last
from dcgrid_env.engine.dynamics import State
from dcgrid_env.engine.parameters import constants
from dcgrid_env.powerflow import Solution
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


def team_costs(scenario: Scenario, state: State, solution: Solution, last: Array) -> Costs:
    """The terms of c_t after a step, (lane,) each; the leftover is charged where ``last`` (bool) is True."""
    xp, w, known = namespace(state.v_pu), scenario.weights, constants(scenario, state.v_pu)
    n_bus = scenario.feeder.n_bus - 1
    v = state.v_pu[..., 1:]
    deviation = xp.abs(v - 1.0)
    excess = positive_part(deviation - scenario.band_pu)
    backlog = sum_last(state.backlog_kws) / known.p_rated_sum_kw
    effort = xp.abs(state.q_kvar) / known.s_rated_kva
    none = 0.0 * backlog
    return Costs(
        voltage=sum_last(voltage_cost(scenario.voltage_cost, deviation, scenario.band_pu)) * (w.voltage / n_bus),
        violation=sum_last(excess) * (w.violation / n_bus),
        backlog=backlog * w.backlog,
        effort=sum_last(effort) * (w.effort / scenario.n_agents),
        clock=sum_last(_clock_share(scenario, state)) * (w.clock / max(scenario.n_datacenters, 1)) if w.clock else none,
        step=sum_last(xp.abs(v - state.v_last_pu[..., 1:])) * (w.step / n_bus) if w.step else none,
        loss=solution.loss_kw * (w.loss / known.p_all_kw) if w.loss else none,
        leftover=backlog * w.leftover * last,
    )


def local_costs(scenario: Scenario, state: State, solution: Solution, last: Array) -> Costs:
    """The same terms as each agent has them alone, (lane, n_agent): its own voltage, backlog, effort and clock.

    The feeder's loss is nobody's own and is charged to all alike.
    """
    xp, w, known = namespace(state.v_pu), scenario.weights, constants(scenario, state.v_pu)
    deviation = xp.abs(state.v_agent_pu - 1.0)
    none = 0.0 * deviation
    own_dc = none[..., scenario.n_datacenters :]
    backlog = xp.concat((state.backlog_kws / known.datacenter.p_rated_kw, own_dc), axis=-1)
    return Costs(
        voltage=voltage_cost(scenario.voltage_cost, deviation, scenario.band_pu) * w.voltage,
        violation=positive_part(deviation - scenario.band_pu) * w.violation,
        backlog=backlog * w.backlog,
        effort=xp.abs(state.q_kvar) / known.s_rated_kva * w.effort,
        clock=xp.concat((_clock_share(scenario, state), own_dc), axis=-1) * w.clock,
        step=xp.abs(state.v_agent_pu - state.v_agent_last_pu) * w.step,
        loss=none + (solution.loss_kw * (w.loss / known.p_all_kw))[..., None],
        leftover=backlog * w.leftover * last[..., None],
    )


def _clock_share(scenario: Scenario, state: State) -> Array:
    span = scenario.f_max_mhz - scenario.f_min_mhz or 1.0
    return namespace(state.f_mhz).abs(state.f_mhz - state.f_last_mhz) / span


def total(costs: Costs) -> Array:
    """Sum of the terms: of charged ones, the step's share of J times T."""
    c = costs
    return c.voltage + c.violation + c.backlog + c.effort + c.clock + c.step + c.loss + c.leftover


def largest_costs(scenario: Scenario) -> Costs:
    """An upper bound of each term, as floats: what a step is charged once the power flow has no solution.

    Voltage anywhere from 0 to 2 p.u., all work of the episode queued, full effort, clock and voltage swinging from end
    to end, and twice all that is drawn lost (a feeder at its limit loses about as much as it delivers), sites as far
    above their ratings as the scenario lets them.
    """
    w = scenario.weights
    farthest = np.ones(1)  # the deviation at which every voltage cost is largest
    queued = (scenario.boost_share - scenario.idle_share) * scenario.horizon * scenario.dt_s
    return Costs(
        voltage=w.voltage * float(voltage_cost(scenario.voltage_cost, farthest, scenario.band_pu)[0]),
        violation=w.violation * (1.0 - scenario.band_pu),
        backlog=w.backlog * queued,
        effort=w.effort,
        clock=w.clock,
        step=w.step,
        loss=2.0 * w.loss * scenario.boost_share,
        leftover=w.leftover * queued,
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
    *each_step, leftover = largest_costs(scenario)
    due = [*(worst * remaining for worst in each_step), leftover + 0 * remaining]

    def choose(a: Array, b: Array) -> Array:
        return xp.where(converged, a, b) if a.ndim == 1 else xp.where(converged[..., None], a, b[..., None])

    return Costs._make(map(choose, costs, due))
