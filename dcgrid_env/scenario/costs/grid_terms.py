"""The terms of a step's cost that the grid brings, one record each, next to what it charges.

A new term is a function and a record in ``TERMS``. Everything else is derived from the records: the weights of a
scenario, the costs of a step and their bounds, and the metrics ``cost_*``. So are the constraint in ``info``, and the
controllers that accept a scenario which charges the term.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, positive_part, sum_last
from dcgrid_env.core.metric import Table
from dcgrid_env.scenario.costs import equipment_moves, load_requests, overload, utility_limits
from dcgrid_env.scenario.costs.voltage_reference import agents_deviation, beyond_band


class Step(NamedTuple):
    """Input of a term: a scenario and its state after a step."""

    scenario: Any
    state: Any
    solution: Any
    params: Any
    """Parameters of the scenario as arrays of the state's kind."""
    judged: slice
    """Nodes whose voltages are charged: all but the substation's."""
    n_nodes: int
    """Their number."""
    n_converters: int
    voltage_sum: Array
    """Sum of the voltage cost over the charged nodes, (row,)."""
    excess_sum: Array
    """Sum of the excess over the band, (row,)."""
    nodes: Array | None = None
    """Nodes of the agents, as in ``Exogenous.nodes``; None where no term asks for them."""

    @property
    def voltages_pu(self) -> tuple[Array, Array]:
        """Voltages of the charged nodes now and one step before, (row, node) each."""
        return self.state.v_pu[..., self.judged], self.state.v_last_pu[..., self.judged]


def _one(_: object) -> float:
    return 1.0


class GridTerm(NamedTuple):
    """A term of the cost.

    A step is charged ``amount * weight / divisor`` for the team.
    """

    name: str
    """Name of its weight, and of its metric after ``cost_``."""
    label: str
    """Name in tables."""
    meaning: str
    weight: float = 0.0
    """Default of the weight."""
    amount: Callable[[Step], Array] | None = None
    """Amount of the whole grid, (row,); None for a term of which devices bring the amounts."""
    divisor: Callable[[Step], float] = _one
    """Number that the amount is a sum over; it does not depend on the state."""
    of_agents: Callable[[Step], Array] | None = None
    """Amount of each agent, (row, n_agent); None where every agent is charged the team's term."""
    largest: Callable[[Any], float] = _one
    """Upper bound of ``amount / divisor`` on a scenario, charged when the power flow has no solution."""
    needs: Literal["", "three phases", "ratings"] = ""
    """What a feeder must have for the term."""
    limit: str = ""
    """Field of the scenario without which the weight has no meaning."""
    is_always_listed: bool = True
    """Whether the term is in ``info`` at weight 0 too, on feeders that have it."""
    is_constraint: bool = False
    """Whether the term is part of ``info["cost"]``, which constrained learners keep low."""
    is_modelled: bool = False
    """Whether controllers with a model of the cost account for it: hindsight and MPC."""
    tables: tuple[Table, ...] = ()
    """Tables that show its metric."""


def voltage_cost(kind: str, deviation: Array, band_pu: float) -> Array:
    """Cost of a voltage's ``deviation`` from its reference, p.u., elementwise, unweighted.

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
        excess = beyond_band(deviation, band_pu)
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


def _voltage_of_agents(step: Step) -> Array:
    cost, state = step.scenario.cost, step.state
    deviation = agents_deviation(step.scenario, state.v_agent_pu, state.v_pu, step.nodes)
    return voltage_cost(cost.voltage, deviation, cost.band_pu)


def _violation_of_agents(step: Step) -> Array:
    return beyond_band(step.state.v_agent_pu - 1.0, step.scenario.cost.band_pu)


def _effort(step: Step) -> Array:
    """Share of each converter's rating that is reactive power, (row, n_agent)."""
    q = step.state.q_kvar
    return namespace(q).abs(q) / step.params.converter_kva


def _change(now: Array, before: Array) -> Array:
    return namespace(now).abs(now - before)


def mean_unbalance(step: Step) -> Array:
    """Mean over three-phase buses of the squared voltage unbalance factor, taken as 1 at most, (row,)."""
    factor = step.state.three_phase.unbalance
    return sum_last(1.0 - positive_part(1.0 - factor * factor)) / max(factor.shape[-1], 1)


def _ramps_of_agents(step: Step) -> Array:
    over, cut = utility_limits.ramp_excess(step.scenario, step.state), utility_limits.sites(step.scenario)
    zero = 0.0 * step.state.v_agent_pu
    return namespace(over).concat((zero[..., : cut.start], over, zero[..., cut.stop :]), axis=-1)


def _nodes(step: Step) -> float:
    return step.n_nodes


TERMS = (
    GridTerm(
        "voltage",
        "voltage cost",
        "mean voltage cost of the nodes, abs(V - 1) unless the scenario has another form or reference",
        100.0,
        amount=attrgetter("voltage_sum"),
        divisor=_nodes,
        of_agents=_voltage_of_agents,
        # The deviation at which every form of the voltage cost is largest is 1.
        largest=lambda scenario: float(voltage_cost(scenario.cost.voltage, np.ones(1), scenario.cost.band_pu)[0]),
        is_modelled=True,
    ),
    GridTerm(
        "violation",
        "violation cost",
        "mean excess of abs(V - 1) over the band",
        1000.0,
        amount=attrgetter("excess_sum"),
        divisor=_nodes,
        of_agents=_violation_of_agents,
        largest=lambda scenario: 1.0 - scenario.cost.band_pu,
        is_constraint=True,
        is_modelled=True,
        tables=("benchmark",),
    ),
    GridTerm("backlog", "backlog cost", "queued work over the rated power of all sites", 0.3, is_modelled=True),
    GridTerm(
        "effort",
        "effort cost",
        "mean abs(q) over the apparent-power rating of the converters",
        0.02,
        amount=lambda step: sum_last(_effort(step)),
        divisor=lambda step: step.n_converters,
        of_agents=_effort,
        is_modelled=True,
    ),
    GridTerm("clock", "clock movement cost", "mean movement of the clocks as a share of their range"),
    GridTerm(
        "step",
        "voltage step cost",
        "mean abs(V_t - V_{t-1})",
        amount=lambda step: sum_last(_change(*step.voltages_pu)),
        divisor=_nodes,
        of_agents=lambda step: _change(step.state.v_agent_pu, step.state.v_agent_last_pu),
    ),
    GridTerm(
        "loss",
        "loss cost",
        "loss of the feeder as a share of its base load and the data centres' ratings",
        amount=attrgetter("solution.loss_kw"),
        divisor=lambda step: step.params.p_all_kw,
        # A feeder at its limit loses about as much as it delivers.
        largest=lambda scenario: 2.0 * max(device.largest_draw_share for device in scenario.devices),
    ),
    GridTerm("leftover", "leftover work cost", "work queued at the end over rated power", 9.0, is_modelled=True),
    GridTerm(
        "unbalance",
        "unbalance cost",
        "mean squared voltage unbalance factor of three-phase buses, at most 1",
        amount=mean_unbalance,
        needs="three phases",
    ),
    GridTerm(
        "switching",
        "switching cost",
        "mean number of tap moves and switchings of the regulators and capacitor banks that are not fixed",
        amount=lambda step: equipment_moves.mean_switching(step.scenario, step.state.three_phase.equipment),
        of_agents=lambda step: equipment_moves.switching_of_agents(step.scenario, step.state),
        largest=equipment_moves.largest_switching,
        needs="three phases",
    ),
    GridTerm(
        "ramp_excess",
        "ramp excess cost",
        "mean over sites of the excess of ramps over ``ramp_limit_kw_per_s``, as a share of that limit",
        amount=lambda step: sum_last(utility_limits.ramp_excess(step.scenario, step.state)),
        divisor=lambda step: step.scenario.n_sites,
        of_agents=_ramps_of_agents,
        largest=utility_limits.largest_ramp_excess,
        limit="ramp_limit_kw_per_s",
        is_always_listed=False,
        is_constraint=True,
    ),
    GridTerm(
        "voltage_step_excess",
        "voltage step excess cost",
        "mean over nodes of the excess of voltage changes over ``voltage_step_limit_pu``, as a share of that limit",
        amount=lambda step: sum_last(utility_limits.voltage_step_excess(step.scenario, *step.voltages_pu)),
        divisor=_nodes,
        of_agents=lambda step: utility_limits.voltage_step_excess(
            step.scenario, step.state.v_agent_pu, step.state.v_agent_last_pu
        ),
        largest=utility_limits.largest_voltage_step_excess,
        limit="voltage_step_limit_pu",
        is_always_listed=False,
        is_constraint=True,
    ),
    GridTerm(
        "overload",
        "overload cost",
        "mean over rated branches of the excess of currents over ratings, as a share of the rating",
        amount=lambda step: overload.mean_overload(step.scenario, step.state.loading),
        largest=lambda _: overload.MOST_EXCESS,
        needs="ratings",
        is_always_listed=False,
        is_constraint=True,
    ),
    GridTerm(
        "grid_request",
        "request cost",
        "distance of the sites' total draw from the utility's request, as a share of the sum of their ratings",
        amount=lambda step: load_requests.missed(step.scenario, step.state),
        largest=load_requests.largest_missed,
        is_always_listed=False,
        is_constraint=True,
    ),
)
"""The terms, in the order in which they are summed up."""
