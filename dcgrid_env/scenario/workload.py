"""Workload of the data centres, and the background: other loads, capacitors and the time of day."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from dcgrid_env.core.checked import FieldError, choice, finite, number, refuse, settle
from dcgrid_env.core.suggestions import nearest
from dcgrid_env.traces import TRACE_SOURCES, PowerTrace, TraceError, is_recording, recorded_trace

TraceWindow = Literal["random", "start", "together"]
RecordingSplit = Literal["time", "recording"]
TraceScale = Literal["rated", "as-recorded"]


@dataclass(frozen=True, kw_only=True)
class Workload:
    """Power that data centres would draw at the highest clock with an empty queue."""

    trace: str | tuple[PowerTrace, ...] = "inference"
    """Source: a name (``dcgrid list``) or recordings, each scaled as ``trace_scale`` says.

    The first 60 % of a recording are for training, then 20 % for validation and 20 % for test, and each part must be as
    long as an episode. The split ``whole`` has all of it, and repeats a recording that is shorter. Plain form: a
    generator's name, a recording's name or file, or a list of recordings."""
    trace_scale: TraceScale = choice("rated", "as-recorded", default="rated")
    """Scale of a recording's power. ``rated`` scales it to the site: its rating, or its highest power if the rating
    is unknown, becomes the site's rating. ``as-recorded`` keeps its kW, which must not exceed the site's rating."""
    recording_split: RecordingSplit = choice("time", "recording", default="time")
    """Whether each recording is cut in time, or whole recordings go to the splits in these shares."""
    window: TraceWindow = choice("random", "start", "together", default="random")
    """Start of an episode in a trace: random for each site, the trace's start, or a random time shared by all sites.

    With the shared time (``together``), power that was recorded or generated simultaneously remains simultaneous.
    Where the scenario follows the day, a recording with dates begins at the time of the episode instead, except with
    ``start``.
    """
    site_correlation: float = number(0.0, 1.0, default=0.0)
    """Probability that a site has the same row and time as the first one; 1 for all sites in step."""
    compute_share: float = number(0.0, 1.0, default=1.0)
    """Compute-bound share of the work if the trace does not define it (recordings), for a law of two work classes."""
    full_load_s: tuple[float, float] | None = None
    """Begin and end of a period of each episode in which the demand of every site is at least its rating, s; None for
    no such period."""

    def __post_init__(self) -> None:
        settle(self, trace=_trace)
        if self.full_load_s is not None and not _is_period(self.full_load_s):
            raise refuse(self, "full_load_s", "give its begin and its end, 0 <= begin < end, in s, or None")
        if isinstance(self.trace, str):
            if self.trace not in TRACE_SOURCES:
                raise refuse(
                    self,
                    "trace",
                    nearest(self.trace, TRACE_SOURCES, "`dcgrid list traces` lists all; or give recordings or a file"),
                )
        elif not isinstance(self.trace, tuple) or not self.trace or not _are_traces(self.trace):
            raise refuse(self, "trace", "give a source's name, a PowerTrace or a tuple of them")


@dataclass(frozen=True, kw_only=True)
class Background:
    """Loads and capacitors of the feeder in addition to the devices, and the time of day."""

    capacitors: bool = choice(True, False, default=True)
    """Whether the feeder's capacitors are connected."""
    load_sigma: float = number(0.0, 0.3, default=0.05)
    """Standard deviation of the other loads' noise as a share of the load."""
    load_rho: float = number(0.0, 0.999999, default=0.9)
    """Correlation of that noise over one second."""
    start_hour: float | Literal["random"] | None = None
    """Time of day at which an episode begins, h in [0, 24), or "random": drawn in each episode. Base load, generated PV
    and generated requests then follow the time of day (``traces.day_course``). None: "random" for an episode longer
    than an hour; a shorter one stays at the feeder's nominal load and at noon."""

    def __post_init__(self) -> None:
        settle(self)
        hour = self.start_hour
        if hour not in (None, "random") and not (finite(hour, 0.0, 24.0) and hour != 24):
            raise refuse(self, "start_hour", "give an hour from 0 to less than 24, 'random', or None")


def _is_period(value: object) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(finite, value)) and 0.0 <= value[0] < value[1]


def _are_traces(values: tuple[Any, ...]) -> bool:
    return all(isinstance(value, PowerTrace) for value in values)


def _trace(value: object) -> Any:
    """Return the recordings for names and files; any other value unchanged."""
    if isinstance(value, PowerTrace):
        return (value,)
    if is_recording(value):
        return (_recording(value),)
    if isinstance(value, list | tuple):
        in_file = [isinstance(item, str | Path) and item not in TRACE_SOURCES for item in value]
        return tuple(_recording(v) if is_in_file else v for v, is_in_file in zip(value, in_file, strict=True))
    return value


def _recording(value: object) -> PowerTrace:
    try:
        return recorded_trace(str(value))
    except (TraceError, OSError) as error:
        raise FieldError("Workload", "trace", str(value), str(error)) from None
