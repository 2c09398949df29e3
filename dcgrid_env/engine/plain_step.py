"""A step of a few environments of a plain scenario in one compiled call.

Otherwise a step of one environment consists of two hundred short calls, which take several times as long as their
arithmetic. The compiled call runs the kernels of the parts in the same order, so results have the same bits. ``fits``
states which scenarios are plain. Other scenarios, larger batches and steps in which a power flow has no solution go
through ``dynamics.step``.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.compiled import compiled
from dcgrid_env.core.coverage import Coverage
from dcgrid_env.devices import converter
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.datacenter import datacenter
from dcgrid_env.engine.cost import observation, reward
from dcgrid_env.engine.cost.plain_figures import (
    ARRAYS,
    COSTS,
    SETTINGS,
    charge,
    charge_constants,
    is_plain,
    sum_of_terms,
)
from dcgrid_env.engine.exogenous.episode import Episode
from dcgrid_env.engine.physics import grid_pass
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.physics.grid_pass import few_rows
from dcgrid_env.engine.physics.known_fields import OUTSIDE
from dcgrid_env.engine.physics.loads import load_noise
from dcgrid_env.engine.physics.parameters import parameters
from dcgrid_env.engine.physics.state import Exogenous, LoadsToDraw, State, VoltageFigures
from dcgrid_env.engine.physics.step_kernels import joint_observation, setpoints
from dcgrid_env.engine.snapshot import Snapshot, Transition
from dcgrid_env.powerflow.balanced.compiled_blocks import FEW
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.sensing import Sensing

dispatch_rows, serve_linearly = converter.dispatch.rows, datacenter.serve_linearly.rows
COVERED = Coverage(
    SETTINGS | {Sensing: "preview regulator_delay_s r_model_share x_model_share model_open* model_closed*"},
    {
        **OUTSIDE,
        **ARRAYS,
        Episode: "key buses placed start sun begin_h still fault sag request",
        Transition: """
            observation reward terminated truncated costs voltages cost_j j_so_far state loss_kw converged trace_start
            buses fault reward_vector
        """,
    },
)
"""What the compiled step covers."""


def fits(scenario: Scenario, n_env: int) -> bool:
    """Whether steps of so many environments can be one call.

    The grid must be one of ``grid_pass.fits``, and devices, cost and observations those of
    ``plain_figures.is_plain``. Agents observe voltages without noise or delay.
    """
    return n_env <= FEW and grid_pass.fits(scenario) and is_plain(scenario, COVERED)


def plain_step(
    scenario: Scenario, now: Snapshot, action: np.ndarray, outside: Exogenous, p_ref_next: np.ndarray
) -> tuple[State, np.ndarray, Transition] | None:
    """Advance environments by one step.

    Parameters
    ----------
    scenario, now
        A scenario that fits, and the environments before the step.
    action
        Joint actions, (row, n_action).
    outside
        External inputs of the interval, with loads that are not drawn yet.
    p_ref_next
        What the sites would draw over the next interval, kW, (row, n_site).

    Returns
    -------
    state, noise, transition
        State and load noise at the end of the interval, and the transition with the shared reward; None if the power
        flow of an environment has no solution.
    """
    before, drawn, placed = now.state, now.episode, now.episode.placed
    sites, loads = before.devices[0], cast(LoadsToDraw, outside.to_draw)
    (n_row, n), n_site, n_agent = loads.noise.shape, p_ref_next.shape[1], before.p_kw.shape[1]
    over_buses, restart = np.empty((4, n_row, n)), np.empty((n_row, n - 1))
    over_sites, over_agents = np.empty((4, n_row, n_site)), np.empty((4, n_row, n_agent))
    per_row, flags = np.empty((7 + len(COSTS) + 3, n_row)), np.empty((3, n_row), np.bool_)
    f_before = np.ascontiguousarray(sites.f_mhz)  # a view of actions behind ``dynamics.step``
    set_up, grid, charged, seen = _fixed(scenario)
    joint = np.empty((n_row, len(seen[1])), np.float32)
    failed = _step_rows(
        0, n_row, action, *set_up, sites.backlog_kws, f_before, outside.p_ref_kw, outside.p_inverter_kw,
        *grid, *loads[:4], *load_noise(scenario), placed.nodes, before.restart,
        *charged, now.transition.j_so_far, before.v_agent_pu, placed.r, placed.x, p_ref_next, *seen,
        over_buses, restart, over_sites, over_agents, per_row, flags, joint,
    )  # fmt: skip
    if failed:
        return None
    backlog, arrived, served, clock = over_sites
    v_agent, p_agent, q_agent, q_limit = over_agents
    deviation, excess, lowest, highest, loss, _, _, *terms, cost_j, paid, j_so_far = per_row
    converged, terminated, last = flags
    state = State(
        v_pu=over_buses[1],
        v_last_pu=before.v_pu,
        v_agent_pu=v_agent,
        v_agent_last_pu=before.v_agent_pu,
        restart=restart,
        p_kw=p_agent,
        q_kvar=q_agent,
        q_limit_kvar=q_limit,
        devices=(
            DataCenterState(backlog, clock, sites.f_mhz, arrived, served, backlog, arrived, served),
            *before.devices[1:],
        ),
    )
    return (
        state,
        over_buses[0],
        Transition(
            observation=joint,
            reward=paid,
            terminated=terminated,
            truncated=last,
            costs=reward.terms(scenario).kind._make(terms),
            voltages=VoltageFigures(deviation, excess, lowest, highest),
            cost_j=cost_j,
            j_so_far=j_so_far,
            state=state,
            loss_kw=loss,
            converged=converged,
            trace_start=drawn.start,
            buses=drawn.buses,
            fault=drawn.fault,
        ),
    )


@cached_on_owner
def _fixed(scenario: Scenario) -> tuple[tuple[Any, ...], ...]:
    """Return the constants of a scenario for the kernel: of devices, grid, cost and observation."""
    params, layout = parameters(scenario, np.empty(0)), action_layout(scenario)
    sites: Any = scenario.devices[0]
    of_sites = params.devices[0]
    devices = (
        params.middle, params.half_range, params.minus_one, params.one,
        np.arange(layout.n)[layout.columns[0][0]], params.reactive, of_sites.p_idle_kw, of_sites.p_dynamic_kw,
        of_sites.f_max_mhz, float(scenario.dt_s), sites.boost_share > 1.0, params.converter_kva, params.q_scale_kvar,
    )  # fmt: skip
    seen = observation.raw_layout(scenario)
    return (
        devices,
        grid_pass.fixed(scenario),
        (*charge_constants(scenario), scenario.horizon),
        (seen.scale, seen.column, *observation.joint_bounds(scenario)),
    )


@compiled
def _step_rows(
    first, last, action, middle, half_range, lowest, highest, clock_at, reactive_at, p_idle, p_dynamic, f_max, dt_s,
    boosts, converter_kva, q_scale, backlog, f_before, p_ref, injection,
    order, parent, r, x, shunt_g, shunt_b, ratio, source_pu, tolerance, max_sweeps, judged, band_pu,
    key, step, noise, share, rho, sigma, p_base, q_base, q_fixed, nodes, warm,
    factor, share_of, span_mhz, horizon, j_before, v_before, r_seen, x_seen, p_ref_next, scale, column, least, most,
    over_buses, restart, over_sites, over_agents, per_row, flags, joint,
):  # fmt: skip
    """Step the rows; return how many have no solution, in which case the results of all rows are incomplete.

    ``first`` and ``last`` are 0 and the number of rows: a literal 0 would compile further versions of callees. The
    places of ``factor``, ``share_of`` and the costs are those of ``COSTS``. Results are in the last seven arrays.
    """
    (n_row, n_site), n_agent, n = p_ref.shape, len(reactive_at), noise.shape[1]
    asked = setpoints(action, middle, half_range, lowest, highest)
    clock, v_agent, p_agent, q_asked = over_sites[3], over_agents[0], over_agents[1], over_agents[2]
    for row in range(n_row):
        for i in range(n_site):
            clock[row, i] = asked[row, clock_at[i]]
        for i in range(n_agent):
            q_asked[row, i] = asked[row, reactive_at[i]]
    queued, arrived, served, p_site = serve_linearly(p_idle, p_dynamic, f_max, backlog, p_ref, clock, dt_s, boosts)
    for row in range(n_row):
        for i in range(n_site):
            over_sites[0, row, i], over_sites[1, row, i] = queued[row, i], arrived[row, i]
            over_sites[2, row, i] = served[row, i]
        for i in range(n_agent):
            p_agent[row, i] = p_site[row, i] if i < n_site else -injection[row, i - n_site]
    q_agent, q_limit = dispatch_rows(converter_kva, q_scale, p_agent, q_asked)
    failed = few_rows(
        first, last, order, parent, r, x, shunt_g, shunt_b, ratio, source_pu, tolerance, max_sweeps, judged, band_pu,
        key, step, noise, share, rho, sigma, p_base, q_base, q_fixed, nodes, p_agent, q_agent, warm,
        over_buses, restart, per_row, flags[0], np.zeros(n_row, np.int64),
    )  # fmt: skip
    if failed:
        return failed
    raw = np.empty((n_row, len(scale)))
    v_pu = over_buses[1]
    for row in range(n_row):
        is_last = step[row] >= horizon
        flags[1, row], flags[2, row] = False, is_last
        for i in range(n_agent):
            v = v_pu[row, nodes[row, i, 0] - row * n]
            v_agent[row, i], over_agents[2, row, i], over_agents[3, row, i] = v, q_agent[row, i], q_limit[row, i]
            raw[row, i], raw[row, n_agent + i] = v - 1.0, v - v_before[row, i]
            raw[row, 2 * n_agent + i], raw[row, 3 * n_agent + i] = p_agent[row, i], q_agent[row, i]
            raw[row, 4 * n_agent + i] = q_limit[row, i]
            raw[row, 5 * n_agent + i], raw[row, 6 * n_agent + i] = r_seen[row, i], x_seen[row, i]
        for i in range(n_site):
            raw[row, 7 * n_agent + i], raw[row, 7 * n_agent + n_site + i] = p_ref_next[row, i], queued[row, i]
    costs, total = per_row[7:15], per_row[15]
    charge(
        first, per_row[0], per_row[1], q_agent, converter_kva, clock, f_before, queued, flags[2], factor, share_of,
        span_mhz, costs,
    )  # fmt: skip
    sum_of_terms(costs, total)
    for row in range(n_row):
        per_row[16, row], per_row[17, row] = -total[row], j_before[row] + total[row] / horizon
    observed = joint_observation(raw, scale, column, least, most)
    for row in range(n_row):  # a loop compiles in a tenth of the time of a slice
        for i in range(len(column)):
            joint[row, i] = observed[row, i]
    return 0
