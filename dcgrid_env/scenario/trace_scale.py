"""What the kilowatts of a recording become at the sites: scaled to their ratings, or as they were recorded."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.checked import refuse
from dcgrid_env.traces import PowerTrace


class ScaledRecording(NamedTuple):
    """A recording and the factor by which its power is multiplied."""

    name: str
    full_kw: float
    """Power that becomes the rating of a site: the recording's own rating, or its highest power."""
    is_rating: bool
    """Whether it is the recording's own rating."""
    factors: tuple[float, ...]
    """Factor at each site; 1 for power as recorded."""


def scaled_recordings(scenario: Any) -> tuple[ScaledRecording, ...]:
    """The recordings that a scenario's sites follow and their factors; empty for generated load."""
    if isinstance(scenario.workload.trace, str):
        return ()
    found = []
    for trace in scenario.workload.trace:
        unrated, full_kw = trace.rated_kw is None, _full_kw(trace)
        factors = np.ones(scenario.n_sites)
        if (
            scenario.workload.trace_scale == "rated"
        ):  # an unknown rating: the highest power is the highest draw of a site
            factors = scenario.site_rated_kw * (scenario.largest_boost if unrated else 1.0) / full_kw
        found.append(ScaledRecording(trace.name, full_kw, not unrated, tuple(factors.tolist())))
    return tuple(found)


def scaling_lines(scenario: Any) -> list[str]:
    """What is done to the power of each recording, a line each; none where no site follows a recording."""
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
    """The recordings with the rating that their power is taken as a share of, and what 1 is at each site, kW."""
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


def _full_kw(trace: PowerTrace) -> float:
    return float(trace.power_kw.max()) if trace.rated_kw is None else float(trace.rated_kw)
