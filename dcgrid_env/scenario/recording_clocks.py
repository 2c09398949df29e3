"""Whether recordings with dates run on the clock of a scenario."""

from __future__ import annotations

from datetime import date
from typing import Any

from dcgrid_env.traces import PowerTrace
from dcgrid_env.traces.recording_clock import clock_of


def recordings_of(scenario: Any) -> tuple[PowerTrace, ...]:
    """Return the recordings that a scenario's sites follow; none for generated load."""
    trace = scenario.workload.trace
    return () if isinstance(trace, str) else trace


def runs_on_clock(scenario: Any) -> bool:
    """Return whether episodes begin in a recording at their date or time of day where possible.

    They do in a scenario that follows the day, in a recording with dates, unless ``workload.window`` is ``start``.
    """
    if not scenario.follows_day or scenario.workload.window == "start":
        return False
    return any(clock_of(trace) is not None for trace in recordings_of(scenario))


def midnight_s(scenario: Any) -> float | None:
    """Return the midnight before the first sample of the load profiles, s since 1970 on their own clock.

    None if the scenario has no load profiles, or these have no dates.
    """
    table = scenario.load_profiles.file
    if table is None or not table.first_day:
        return None
    return 86400.0 * (date.fromisoformat(table.first_day) - date(1970, 1, 1)).days
