"""Where episodes begin in recordings with dates: at their date and time of day, or at their time of day."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.engine.exogenous.trace_pool import trace_pool, window_steps
from dcgrid_env.scenario.load_profiles import profile_begins_h
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.site_recordings import midnight_s, recordings_of, runs_on_clock
from dcgrid_env.traces import WHOLE, TraceRows
from dcgrid_env.traces.recorded_rows import is_repeated
from dcgrid_env.traces.recording_clock import clock_of

_DAY_S = 86400.0
_ROUNDING = 1e-6
_BEGINS = 500
"""Number of episode begins in a range of time for which ``clock_lines`` finds how a recording is aligned."""


class Aligned(IntEnum):
    """How an episode begins in a recording."""

    NOT = 0
    BY_HOUR = 1
    """At its time of day, on another day."""
    BY_DATE = 2
    """At its date and time of day."""


class _RowClocks(NamedTuple):
    """Clock of each row of a pool, arrays (n_row,)."""

    begin_s: np.ndarray
    """Begin on the clock of the load profiles, s since 1970; NaN if not known."""
    local: np.ndarray
    """Whether that is the local clock of the files, since not both state UTC offsets, bool."""
    room: np.ndarray
    """Steps by which a window may begin later than the row."""


@cached_on_owner
def row_clocks(scenario: Scenario) -> _RowClocks | None:
    """Return the clocks of the rows of a scenario's pool; None where nothing runs on a clock."""
    pool = trace_pool(scenario)
    if not runs_on_clock(scenario) or not isinstance(pool, TraceRows):
        return None
    table = scenario.load_profiles.file
    offset_h = None if table is None else table.utc_offset_h
    begins = [np.nan if clock is None else clock.local_s(offset_h) for clock in pool.clocks]
    local = [offset_h is None or clock is None or clock.utc_offset_h is None for clock in pool.clocks]
    return _RowClocks(np.array(begins), np.array(local), np.array(pool.row_steps) - window_steps(scenario))


def starts_on_clock(
    scenario: Scenario, clocks: _RowClocks, row: np.ndarray, begin_h: np.ndarray, bits: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the step of its row at which each window begins, and how that is aligned (``Aligned``).

    Parameters
    ----------
    scenario, clocks
        The scenario, and its ``row_clocks``.
    row
        Row of the pool, (n, n_site).
    begin_h
        Begin of each episode, h, as ``Episode.begin_h``, (n,).
    bits
        Random bits that choose the day of windows by time of day, and the begin of others, uint64, (n, n_site) or
        (n, 1).
    """
    dt_s, room = float(scenario.dt_s), clocks.room[row]
    midnight = midnight_s(scenario)
    table = scenario.load_profiles.file
    clock_h = begin_h if table is None else table.clock_h(begin_h)
    clock_h = np.where(clocks.local[row], clock_h[:, None], begin_h[:, None])
    later_s = 3600.0 * clock_h + (midnight or 0.0) - clocks.begin_s[row]
    known = np.isfinite(later_s)
    later_s = np.where(known, later_s, 0.0)
    by_date = np.floor(later_s / dt_s + _ROUNDING).astype(np.int64)
    dated = known & (midnight is not None) & (by_date >= 0) & (by_date <= room)
    hour_s = later_s % _DAY_S
    hour_s = np.where(_DAY_S - hour_s < _ROUNDING * dt_s, 0.0, hour_s)
    days = np.where(known, np.floor((room * dt_s - hour_s) / _DAY_S + _ROUNDING).astype(np.int64) + 1, 0)
    day = (bits % np.maximum(days, 1).astype(np.uint64)).astype(np.int64)
    by_hour = np.floor((hour_s + _DAY_S * day) / dt_s + _ROUNDING).astype(np.int64)
    free = (bits % (room + 1).astype(np.uint64)).astype(np.int64)
    start = np.where(dated, by_date, np.where(days > 0, np.minimum(by_hour, room), free))
    return start, np.where(dated, Aligned.BY_DATE, np.where(days > 0, Aligned.BY_HOUR, Aligned.NOT))


def recording_lines(scenario: Scenario) -> list[str]:
    """Describe which recordings are repeated and whether they run on the clock of the scenario, a line each."""
    needed_s = window_steps(scenario) * float(scenario.dt_s)
    lines = [
        f"trace {trace.name}: lasts {trace.duration_s:g} s and episodes need {needed_s:g} s, so it is repeated, every "
        "second time backwards, which gives no jump where it begins again"
        for trace in recordings_of(scenario)
        if scenario.split == WHOLE and is_repeated(trace, float(scenario.dt_s), needed_s)
    ]
    return [*lines, *_clock_lines(scenario)]


def _clock_lines(scenario: Scenario) -> Iterator[str]:
    dated = [trace for trace in recordings_of(scenario) if clock_of(trace) is not None]
    with_dates = midnight_s(scenario) is not None
    if not scenario.follows_day or not (dated or with_dates):
        return
    owner = "the load profiles" if scenario.load_profiles.file is not None else "the scenario's day"
    for trace in recordings_of(scenario):
        if clock_of(trace) is None:
            yield f"trace {trace.name}: has no dates, so it does not run on the clock of {owner}"
        elif scenario.workload.window == "start":
            yield f"trace {trace.name}: begins at its first sample (workload.window = 'start'), not on the clock"
    clocks = row_clocks(scenario)
    if clocks is None:
        return
    begins = _begins_h(scenario)
    rows = np.flatnonzero(np.isfinite(clocks.begin_s))
    zeros = np.zeros((len(begins), 1), np.uint64)
    alignments = [
        starts_on_clock(scenario, clocks, np.full_like(zeros, row, np.int64), begins, zeros)[1] for row in rows
    ]
    if not alignments:
        names = ", ".join(trace.name for trace in dated)
        yield f"trace {names}: does not run on the clock of {owner}, since it is repeated"
        return
    shares = {way: float(np.mean(np.array(alignments) == way)) for way in Aligned}
    names = ", ".join(dict.fromkeys(trace.name for trace in dated))
    ways = {
        Aligned.BY_DATE: "at the date and time of day",
        Aligned.BY_HOUR: "at the time of day, on days of the recording",
        Aligned.NOT: "at random, since the recording has no such time of day",
    }
    said = [f"{_per_cent(shares[way])} of episodes begin {text}" for way, text in ways.items() if shares[way] > 0.0]
    runs = "does not run" if shares[Aligned.NOT] == 1.0 else "runs" if not shares[Aligned.NOT] else "runs in part"
    known = {clock.utc_offset_h is not None for trace in dated if (clock := clock_of(trace)) is not None}
    zone = ""
    if with_dates and len(known | {scenario.load_profiles.table.utc_offset_h is not None}) > 1:
        zone = "; not all of the files state UTC offsets, so their times count as of one time zone"
    yield f"trace {names}: {runs} on the clock of {owner}: {', '.join(said)}{zone}"


def _begins_h(scenario: Scenario) -> np.ndarray:
    """Begins that episodes of a scenario can have, spread evenly, h."""
    hour = scenario.background.start_hour
    if scenario.load_profiles.file is not None:
        ranges = profile_begins_h(scenario)
    else:
        ranges = np.array([(0.0, 24.0)] if hour is None or isinstance(hour, str) else [(hour, hour)])
    lengths = np.maximum(ranges[:, 1] - ranges[:, 0], 1e-9)
    counts = np.maximum(1, np.round(_BEGINS * lengths / lengths.sum()).astype(int))
    parts = zip(ranges.tolist(), counts.tolist(), strict=True)
    return np.concatenate([np.linspace(low, high, n, endpoint=False) for (low, high), n in parts])


def _per_cent(share: float) -> str:
    """Format a share; a small rest is not rounded away."""
    return "100 %" if share == 1.0 else f"{min(max(100.0 * share, 0.1), 99.9):.3g} %"
