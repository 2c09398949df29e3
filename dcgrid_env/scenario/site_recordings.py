"""Recordings that the sites of a scenario follow: their scale at the sites, and whether they run on its clock."""

from __future__ import annotations

from datetime import date
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.checked import refuse
from dcgrid_env.traces import PowerTrace
from dcgrid_env.traces.recording_clock import clock_of


class ScaledRecording(NamedTuple):
    """A recording and the factor by which its power is multiplied."""

    name: str
    full_kw: float
    """Power that becomes the rating of a site: the recording's own rating, or its highest power."""
    is_rating: bool
    """Whether it is the recording's own rating."""
    factors: tuple[float, ...]
    """Factor at each site; 1 for power as recorded."""


def recordings_of(scenario: Any) -> tuple[PowerTrace, ...]:
    """Return the recordings that a scenario's sites follow; none for generated load."""
    trace = scenario.workload.trace
    return () if isinstance(trace, str) else trace


def scaled_recordings(scenario: Any) -> tuple[ScaledRecording, ...]:
    """Return the recordings that a scenario's sites follow and their factors; empty for generated load."""
    recordings = []
    for trace in recordings_of(scenario):
        is_rating = trace.rated_kw is not None
        full_kw = float(trace.power_kw.max() if trace.rated_kw is None else trace.rated_kw)
        factors = np.ones(scenario.n_sites)
        if scenario.workload.trace_scale == "rated":
            # Without a rating, the highest power becomes the highest draw of a site.
            factors = scenario.site_rated_kw * (1.0 if is_rating else scenario.largest_boost) / full_kw
        recordings.append(ScaledRecording(trace.name, full_kw, is_rating, tuple(factors.tolist())))
    return tuple(recordings)


def scaling_lines(scenario: Any) -> list[str]:
    """Return a line on the scale of each recording; none where no site follows one."""
    lines = []
    for name, full_kw, is_rating, factors in scaled_recordings(scenario):
        if not factors:
            continue
        low, high = float(scenario.site_rated_kw.min()), float(scenario.site_rated_kw.max())
        sites = f"{low:g} kW" if low == high else f"{low:g} to {high:g} kW"
        what = "rating" if is_rating else "highest power"
        if scenario.workload.trace_scale == "as-recorded":
            lines.append(f"trace {name}: as recorded ({what} {full_kw:g} kW) at sites of {sites}")
            continue
        by = f"{min(factors):.4g}" if min(factors) == max(factors) else f"{min(factors):.4g} to {max(factors):.4g}"
        lines.append(
            f"trace {name}: its {what} of {full_kw:g} kW becomes the sites' rating of {sites} (times {by}); "
            "--set workload.trace_scale=as-recorded keeps its kW"
        )
    return lines


def as_shares_of(scenario: Any) -> tuple[tuple[PowerTrace, ...], np.ndarray]:
    """Return the recordings as shares of a rating, and what 1 is at each site, kW."""
    if scenario.workload.trace_scale == "rated":
        return scenario.workload.trace, scenario.site_rated_kw
    reference_kw = float(scenario.site_rated_kw.max(initial=1.0))
    return tuple(t.rated_at(reference_kw) for t in scenario.workload.trace), np.full(scenario.n_sites, reference_kw)


def check_trace_scale(scenario: Any) -> None:
    """Raise FieldError for power as recorded of a generator, in shares, or of a recording above a site's rating."""
    if scenario.workload.trace_scale == "rated":
        return
    if isinstance(scenario.workload.trace, str):
        remedy = (
            f"the trace {scenario.workload.trace!r} is generated, in shares of the rating; give recordings, or 'rated'"
        )
        raise refuse(scenario.workload, "trace_scale", remedy)
    most_kw = float(scenario.site_rated_kw.min(initial=np.inf))
    for trace in scenario.workload.trace:
        if trace.is_share:
            remedy = f"trace {trace.name!r} is in shares of a rating; give its rating (with_site_rating), or 'rated'"
            raise refuse(scenario.workload, "trace_scale", remedy)
        if (peak_kw := float(trace.power_kw.max())) > most_kw:
            remedy = f"trace {trace.name!r} rises to {peak_kw:g} kW, above the rating of a site, {most_kw:g} kW; "
            raise refuse(scenario.workload, "trace_scale", f"{remedy}raise datacenters.p_rated_kw, or give 'rated'")


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
