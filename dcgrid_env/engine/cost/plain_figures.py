"""Costs and observations of plain scenarios in one compiled call, with the bits of ``reward`` and ``observation``.

Plain are data centres and inverters in their basic form, the default form of the cost, and local observations. Other
scenarios charge and observe term by term.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.compiled import compiled
from dcgrid_env.core.coverage import Coverage
from dcgrid_env.devices import DataCenters, Inverters
from dcgrid_env.devices.datacenter.clock_law import LinearDvfs
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.engine.cost import observation, reward
from dcgrid_env.engine.physics.connections import Placement
from dcgrid_env.engine.physics.known_fields import SCENARIO
from dcgrid_env.engine.physics.parameters import parameters
from dcgrid_env.engine.physics.state import State, VoltageFigures
from dcgrid_env.engine.physics.step_kernels import joint_observation
from dcgrid_env.engine.physics.voltage_figures import MOST_AT_ONCE, sum_up
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.scenario.cost import Cost
from dcgrid_env.scenario.costs.equipment_moves import moving_equipment
from dcgrid_env.scenario.grid_request import GridRequest
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.sensing import Sensing

COSTS = ("voltage", "violation", "backlog", "effort", "clock", "step", "loss", "leftover")
"""The terms of a plain scenario, in order; ``step`` and ``loss`` have no weight."""
COSTS_OF_PHASES = (*COSTS, "unbalance", "switching")
"""Those on a three-phase feeder; ``unbalance`` has no weight."""
FIELDS = ("v_deviation", "v_change", "p", "q", "q_limit", "r", "x")
"""Fields of the grid that agents of a plain scenario observe, in order."""
FIELDS_OF_PHASES = (*FIELDS, "v_lowest", "v_highest")


class Declared(NamedTuple):
    """What the class of a group of plain devices states, in order."""

    channels: tuple[str, ...]
    fields: tuple[str, ...]
    cost_terms: tuple[tuple[str, str, bool], ...]
    """Name, amount, and whether it is charged at the end."""


DECLARED = {
    DataCenters: Declared(
        ("clock", "q"),
        ("p_ref_next", "backlog"),
        (("backlog", "backlog_kws", False), ("clock", "clock_movement", False), ("leftover", "backlog_kws", True)),
    ),
    Inverters: Declared(("q",), (), ()),
}
"""That of each class of plain devices."""
SETTINGS = SCENARIO | {
    Scenario: """
        name feeder* source_voltage_pu devices workload background sensing cost grid_control grid_request load_profiles
        faults* sags* horizon dt_s power_flow split
    """,
    Cost: """
        weights* band_pu reward default_action default_gains ramp_limit_kw_per_s ramp_window_s voltage_step_limit_pu
    """,
    GridRequest: "notice_s tolerance_share",
    DataCenters: """
        count buses* p_rated_kw* idle_share f_max_mhz f_min_mhz s_rated_share q_max_share clock_law boost_share phases*
    """,
    LinearDvfs: "",
    Inverters: "buses* s_rated_kva* injection* phases*",
}
"""Settings of a plain scenario."""
ARRAYS: dict[type, str] = {
    State: """
        v_pu v_last_pu v_agent_pu v_agent_last_pu restart p_kw q_kvar q_limit_kvar devices three_phase p_window_kw
        loading regulator_views request
    """,
    DataCenterState: """
        backlog_kws f_mhz f_last_mhz arrived_kw served_kw class_backlog_kws class_arrived_kw class_served_kw
    """,
    VoltageFigures: "deviation_pu excess_pu lowest_pu highest_pu",
    Placement: "r x nodes legs nearest",
}
"""State of a plain scenario, and what an episode places."""
COVERED = Coverage(
    SETTINGS
    | {Sensing: "noise_pu delay_steps preview regulator_delay_s r_model_share x_model_share model_open* model_closed*"},
    ARRAYS,
)
"""What the compiled costs and observations cover."""


class PlainFigures(NamedTuple):
    """Costs and observation of a step."""

    costs: Any
    """See ``reward.team_costs``."""
    cost_j: np.ndarray
    """Their sum, (row,)."""
    observation: np.ndarray
    """See ``observation.observe_within_bounds``."""


def is_plain(scenario: Scenario, covered: Coverage) -> bool:
    """Whether a scenario within a coverage is plain.

    Devices are data centres with the linear clock law and without features, and inverters that stay connected. The cost
    has its default form, of any weights, and agents observe what is listed here.
    """
    groups = [type(group) for group in scenario.devices]
    if groups not in ([DataCenters], [DataCenters, Inverters]) or scenario.n_agents > MOST_AT_ONCE:
        return False
    if not covered.includes(scenario) or scenario.datacenters.features or scenario.cost.reward == "local":
        return False
    if any(_declared(scenario, group) != DECLARED[type(group)] for group in scenario.devices):
        return False
    of_phases = isinstance(scenario.feeder, ThreePhaseFeeder)
    terms, fields = (COSTS_OF_PHASES, FIELDS_OF_PHASES) if of_phases else (COSTS, FIELDS)
    charged = {name for name, weight in scenario.cost.weights._asdict().items() if weight}
    if not charged <= {*terms} - {"step", "loss", "unbalance"} or reward.terms(scenario).kind._fields != terms:
        return False
    return tuple(field.name for field in observation.grid_fields(scenario)) == fields


def _declared(scenario: Scenario, group: Any) -> Declared:
    lengths = scenario.horizon, scenario.dt_s
    return Declared(
        tuple(channel.name for channel in group.channels),
        tuple(field.name for field in group.fields(*lengths)),
        tuple((term.name, term.amount, term.at_end) for term in group.cost_terms(*lengths)),
    )


def fits(scenario: Scenario) -> bool:
    """Whether costs and observations can be one call: plain scenarios on three-phase feeders.

    Those on balanced feeders have ``plain_step``.
    """
    return type(scenario.feeder) is ThreePhaseFeeder and is_plain(scenario, COVERED)


def plain_figures(
    scenario: Scenario,
    state: State,
    figures: VoltageFigures,
    last: np.ndarray,
    placed: Placement,
    p_ref_next: np.ndarray,
    measured: tuple[np.ndarray, ...],
) -> PlainFigures:
    """Charge and observe a state on a scenario that fits.

    ``figures`` are those of its voltages, ``last`` is whether episodes end, (row,) bool, ``p_ref_next`` are draws of
    the coming interval, kW, (row, n_site), and ``measured`` begins with the measurements of one step before and of now.
    """
    sites = state.devices[0]
    regulators, banks = state.three_phase.equipment  # pyright: ignore[reportOptionalMemberAccess]
    f_mhz, f_last_mhz = np.ascontiguousarray(sites.f_mhz), np.ascontiguousarray(sites.f_last_mhz)  # views of actions
    charges, seen = _charge_and_observe(
        0, figures.deviation_pu, figures.excess_pu, regulators.moved, banks.switched, f_mhz, f_last_mhz,
        sites.backlog_kws, last, measured[1], measured[0], state.p_kw, state.q_kvar, state.q_limit_kvar, placed.r,
        placed.x, p_ref_next, *_constants(scenario),
    )  # fmt: skip
    *costs, total = charges
    return PlainFigures(reward.terms(scenario).kind._make(costs), total, seen)


def charge_constants(scenario: Scenario) -> tuple[np.ndarray, np.ndarray, float]:
    """Return factor and divisor of each cost term, (n_term,), and the range of the clocks, MHz."""
    terms, sites = reward.terms(scenario), scenario.devices[0]
    factor, share_of = np.zeros(len(terms.kind._fields)), np.ones(len(terms.kind._fields))
    for place, _, of_amount in terms.of_grid:
        factor[place] = of_amount
    for _, term, weight, place in terms.charged:
        factor[place], share_of[place] = weight, term.team_scale
    return factor, share_of, float(sites.f_max_mhz - sites.f_min_mhz) or 1.0  # pyright: ignore[reportAttributeAccessIssue]


@cached_on_owner
def _constants(scenario: Scenario) -> tuple[Any, ...]:
    (factor, share_of, span_mhz), moving = charge_constants(scenario), moving_equipment(scenario)
    share_of[COSTS_OF_PHASES.index("switching")] = max(moving.sum(), 1.0)
    seen, kva = observation.raw_layout(scenario), parameters(scenario, np.empty(0)).converter_kva
    return kva, moving, factor, share_of, span_mhz, seen.scale, seen.column, *observation.joint_bounds(scenario)


@compiled(inner=True)
def charge(
    first, deviation, excess, q_kvar, converter_kva, clock, f_before, queued, last, factor, share_of, span_mhz, costs
):  # fmt: skip
    """Fill the terms of COSTS, (n_term, row).

    ``first`` is 0, as a variable: a literal would compile further versions of callees.
    ``deviation`` and ``excess`` are sums over nodes, (row,), ``q_kvar`` is (row, n_agent), clocks before and after and
    the queued work are (row, n_site), ``factor`` and ``share_of`` (n_term,).
    """
    (n_row, n_agent), n_site = q_kvar.shape, clock.shape[1]
    part = np.empty(n_agent)
    for row in range(n_row):
        for i in range(n_agent):
            part[i] = abs(q_kvar[row, i]) / converter_kva[i]
        effort = sum_up(part, first, n_agent)
        for i in range(n_site):
            part[i] = abs(clock[row, i] - f_before[row, i]) / span_mhz
        moved = sum_up(part, first, n_site) / share_of[4]
        waiting = sum_up(queued[row], first, n_site)
        costs[0, row], costs[1, row] = deviation[row] * factor[0], excess[row] * factor[1]
        costs[2, row], costs[3, row] = waiting / share_of[2] * factor[2], effort * factor[3]
        costs[4, row], costs[5, row], costs[6, row] = moved * factor[4], 0.0, 0.0
        costs[7, row] = waiting / share_of[7] * factor[7] * last[row]


@compiled(inner=True)
def sum_of_terms(costs, total):
    """Fill the sum of terms (n_term, row), one after the other, (row,)."""
    for row in range(len(total)):
        total[row] = costs[0, row]
        for i in range(1, len(costs)):
            total[row] += costs[i, row]


@compiled
def _charge_and_observe(
    first, deviation, excess, moved, switched, clock, f_before, queued, last, v_pu, v_before, p_kw, q_kvar, q_limit,
    r_seen, x_seen, p_ref_next, converter_kva, moving, factor, share_of, span_mhz, scale, column, least, most,
):  # fmt: skip
    """Return the costs of COSTS_OF_PHASES and their sum, (n_term + 1, row), and the joint observation.

    Measured voltages are (row, 3 n_agent), see ``measurement.measure``.
    """
    (n_row, n_agent), n_term, n_site = p_kw.shape, len(factor), queued.shape[1]
    charges, raw = np.zeros((n_term + 1, n_row)), np.empty((n_row, len(scale)))
    charge(
        first, deviation, excess, q_kvar, converter_kva, clock, f_before, queued, last, factor, share_of, span_mhz,
        charges,
    )  # fmt: skip
    n_regulator = moved.shape[1]
    for row in range(n_row):
        moves = 0.0
        for i in range(n_regulator):
            moves += moved[row, i] * moving[i]
        for i in range(switched.shape[1]):
            moves += switched[row, i] * moving[n_regulator + i]
        charges[n_term - 1, row] = moves / share_of[n_term - 1] * factor[n_term - 1]
        for i in range(n_agent):
            v = v_pu[row, i]
            raw[row, i], raw[row, n_agent + i] = v - 1.0, v - v_before[row, i]
            raw[row, 2 * n_agent + i], raw[row, 3 * n_agent + i] = p_kw[row, i], q_kvar[row, i]
            raw[row, 4 * n_agent + i], raw[row, 5 * n_agent + i] = q_limit[row, i], r_seen[row, i]
            raw[row, 6 * n_agent + i], raw[row, 7 * n_agent + i] = x_seen[row, i], v_pu[row, n_agent + i] - 1.0
            raw[row, 8 * n_agent + i] = v_pu[row, 2 * n_agent + i] - 1.0
        for i in range(n_site):
            raw[row, 9 * n_agent + i], raw[row, 9 * n_agent + n_site + i] = p_ref_next[row, i], queued[row, i]
    sum_of_terms(charges[:n_term], charges[n_term])
    return charges, joint_observation(raw, scale, column, least, most)
