"""The rows of trace that a scenario's episodes draw windows from: data centres' load, and PV.

Generated load comes in rows of an hour, about a day in all, wherever these hold enough windows. An episode too long for
that draws from longer rows, made when they are needed; where episode and source follow the day, a row contains all
hours. A short episode that follows the day draws from short rows that begin at its hour.
"""

from __future__ import annotations

import math

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.site_recordings import as_shares_of, runs_on_clock
from dcgrid_env.traces import (
    TRACE_SOURCES,
    RowsOnDemand,
    TraceRows,
    from_recordings,
    library,
    pv_rows,
    require_window,
    rows_on_demand,
)
from dcgrid_env.traces.checks import steps_in

ROW_DURATION_S = 3600.0
"""Length of a generated row; of a longer one what it has to spare beyond an episode, in which windows may begin."""
ROWS = 24
"""How many there are."""
LEAST_WINDOWS = 500
"""Windows that one site can draw, of which no two are the same."""
LEAST_LONG_ROWS = 12
LEAST_HOURLY_ROWS = 4
HOURS = 24
DAY_S = 86400.0


def window_steps(scenario: Scenario) -> int:
    """Steps of trace that an episode needs: t = 0, one an action, and the preview at the end."""
    return scenario.horizon + 2


def trace_pool(scenario: Scenario) -> TraceRows | RowsOnDemand:
    """Rows that the scenario's split draws from: power, (n_row, n_step), and what is known of the work behind it.

    Scenarios on random feeders share them.
    """
    return _trace_pool(scenario.family)


def has_hourly_rows(scenario: Scenario) -> bool:
    """Return whether the pool has rows for each hour of the day, 24 after one another, from which sites choose one."""
    return _by_hour(scenario) and window_steps(scenario) * scenario.dt_s <= ROW_DURATION_S


def _by_hour(scenario: Scenario) -> bool:
    trace = scenario.workload.trace
    return isinstance(trace, str) and scenario.follows_day and TRACE_SOURCES[trace].daily


@cached_on_owner
def _trace_pool(scenario: Scenario) -> TraceRows | RowsOnDemand:
    trace, split, dt_s = scenario.workload.trace, scenario.generator_split, float(scenario.dt_s)
    steps = window_steps(scenario)
    needed_s = steps * dt_s
    if not isinstance(trace, str):
        shares, boost = (
            as_shares_of(scenario)[0],
            scenario.largest_boost if scenario.workload.trace_scale == "rated" else 1.0,
        )
        by, on_clock = scenario.workload.recording_split, runs_on_clock(scenario)
        rows = from_recordings(shares, scenario.split, dt_s, needed_s, boost, by, full_rows=on_clock)
        require_window(rows, steps, dt_s, ", ".join(t.name for t in trace))
        return rows
    # Rounding may cost a step of dt at the end, so one more is asked for.
    duration_s = max(ROW_DURATION_S, needed_s + dt_s)
    # About a day in all, but a row for each site.
    count = min(ROWS, max(scenario.n_sites, round(ROWS * ROW_DURATION_S / duration_s), 1))
    windows = count * (steps_in(duration_s, dt_s) - steps + 1)
    if windows >= LEAST_WINDOWS and not _by_hour(scenario):
        rows = library(trace, split, dt_s, duration_s, count, scenario.largest_boost)
        require_window(rows, steps, dt_s, trace)
        return rows
    spare = spare_steps(dt_s)
    count = max(scenario.n_sites, LEAST_LONG_ROWS, math.ceil(LEAST_WINDOWS / (spare + 1)))
    duration_s = (steps + spare + 1) * dt_s
    if has_hourly_rows(scenario):
        count = HOURS * max(scenario.n_sites, LEAST_HOURLY_ROWS)
        duration_s += DAY_S / HOURS
    elif _by_hour(scenario):
        duration_s += DAY_S
    return rows_on_demand(trace, split, dt_s, duration_s, count, scenario.largest_boost, spare)


@cached_on_owner
def full_trace_kw(scenario: Scenario) -> np.ndarray:
    """Power that a share of 1 in the pool is at each site, kW, (n_site,)."""
    return scenario.site_rated_kw if isinstance(scenario.workload.trace, str) else as_shares_of(scenario)[1]


def spare_steps(dt_s: float) -> int:
    """Steps by which a window may begin later in a long row than it must."""
    return max(1, round(ROW_DURATION_S / dt_s))


def sun_rows(scenario: Scenario) -> np.ndarray:
    """Active injection of the inverters as a share of their rating: a row for all episodes, or those of the PV drawn.

    (n_row, n_step), each row as long as an episode or longer.
    """
    return _sun_rows(scenario.family)


@cached_on_owner
def _sun_rows(scenario: Scenario) -> np.ndarray:
    trace, steps, dt_s = scenario.schedule, scenario.horizon + 1, float(scenario.dt_s)
    if trace is None:
        return np.zeros((1, steps))
    if isinstance(trace, tuple):
        return np.array(trace[:steps])[None]
    if isinstance(trace, str):
        duration_s = max(ROW_DURATION_S, steps * dt_s)
        if ROWS * (steps_in(duration_s, dt_s) - steps + 1) < LEAST_WINDOWS:
            duration_s = (steps + max(spare_steps(dt_s), math.ceil(LEAST_WINDOWS / ROWS))) * dt_s
        return pv_rows(scenario.generator_split, dt_s, duration_s, ROWS)
    trace.require_duration(steps * dt_s)
    return trace.resample(dt_s)[None, :steps]


def check_traces(scenario: Scenario) -> None:
    """Raise TraceError unless every trace lasts as long as an episode."""
    trace_pool(scenario)
    sun_rows(scenario)
