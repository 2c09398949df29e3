"""Rows of power from recordings, cut in time or used whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dcgrid_env.traces.boost import boosted_trace
from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive, steps_in
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.recording_clock import Clock, clock_of
from dcgrid_env.traces.rows import OUT_OF_DISTRIBUTION, SPLITS, WHOLE, TraceRows, checked_boost, checked_split
from dcgrid_env.traces.time_grid import IDLE_SHARE
from dcgrid_env.traces.trace import PowerTrace, RequestTimes

# Shares of a recording's time, train 60 %, validation 20 %, test 20 %, as bounds.
_SPLIT_BOUNDS = {"train": (0.0, 0.6), "validation": (0.6, 0.8), "test": (0.8, 1.0), WHOLE: (0.0, 1.0)}


def from_recordings(
    traces: Sequence[PowerTrace],
    split: str,
    dt_s: float,
    window_s: float = 0.0,
    boost_share: float = 1.0,
    by: str = "time",
    *,
    full_rows: bool = False,
) -> TraceRows:
    """Return rows of power from recordings, each as a share of its rating, or of its peak if the rating is unknown.

    The first 60 % train, the next 20 % validate and the last 20 % test. They are shares of each recording's time, or of
    the recordings in their order. A row is as long as the shortest part. A longer part gives several rows that together
    cover it, with overlap if necessary.

    The split "whole" has all of every recording. One that is shorter than a window is repeated there, every second time
    backwards, so that its power has no jump where it begins again.

    Parameters
    ----------
    traces : at least one recording.
    split : "train", "validation" or "test", no two of which share a sample, or "whole".
    dt_s : step, s.
    window_s : the longest window that will be taken, s; 0 if not known yet.
    boost_share : highest short draw as a share of the rating, at least 1. If the rating is unknown, it is taken to be
        the peak of the recording. Traces whose compute-bound part is known get the boost as generated ones do.
    by : "time" cuts each recording, "recording" gives whole recordings to the splits and needs at least 3.
    full_rows : whether each part is one row; shorter ones then hold their last value to the end, see
        `TraceRows.row_steps`.

    Returns
    -------
    TraceRows of (count, n_steps)

    Raises
    ------
    TraceError
        If `traces` is empty, or a recording's part of the split is shorter than one step or `window_s`.
    """
    if split != WHOLE and checked_split(split) == OUT_OF_DISTRIBUTION:
        raise TraceError(
            "recordings have no split 'ood'; give recordings of another GPU or service as the trace instead"
        )
    low, high = _SPLIT_BOUNDS[split]
    if not traces:
        raise TraceError("from_recordings got no trace; give at least one PowerTrace")
    if not (np.isfinite(window_s) and window_s >= 0):
        raise TraceError(f"window_s = {window_s!r} is not a finite number of at least 0; give a length in seconds")
    needed = max(1, -steps_in(-window_s, require_positive(dt_s, "dt_s", "give a step in seconds")))
    boost_share = checked_boost(boost_share)
    if by == "recording" and split != WHOLE:
        traces, low, high = _whole_recordings(traces, split), 0.0, 1.0
    elif by not in ("time", "recording"):
        raise TraceError(f"by = {by!r} is unknown; cut recordings by time or give them out by recording")
    parts = [_part(trace, split, dt_s, (low, high), needed, boost_share) for trace in traces]
    n_steps = (max if full_rows else min)(len(part.p_share) for part in parts)
    rows, counts = [], []
    for part in parts:
        begins = np.linspace(0, max(0, len(part.p_share) - n_steps), -(-len(part.p_share) // n_steps)).astype(int)
        counts.append(len(begins))
        rows += [part.cut(int(begin), n_steps, dt_s) for begin in begins]
    power, compute, requests, clocks = zip(*rows, strict=True)
    return TraceRows(
        _pool(power, n_steps),
        None if any(row is None for row in compute) else _pool(compute, n_steps),
        () if any(row is None for row in requests) else requests,
        tuple(_noted(trace, boost_share) for trace, n in zip(traces, counts, strict=True) for _ in range(n)),
        clocks,
        tuple(map(len, power)),
    )


def is_repeated(trace: PowerTrace, dt_s: float, window_s: float) -> bool:
    """Return whether a recording is shorter than a window, so that the split "whole" repeats it."""
    return steps_in(trace.duration_s, dt_s) < -steps_in(-window_s, dt_s)


def _noted(trace: PowerTrace, boost_share: float) -> Provenance:
    provenance = trace.provenance
    if boost_share == 1.0:
        return provenance
    return replace(provenance, parameters={**provenance.parameters, "boost_share": boost_share})


class _Part(NamedTuple):
    """A recording's part of a split, or a row of it."""

    p_share: FloatArray
    compute_share: FloatArray | None
    requests: RequestTimes | None
    """Times from the beginning of the part."""
    clock: Clock | None
    """Clock at the beginning of the part."""

    def cut(self, begin: int, n_steps: int, dt_s: float) -> _Part:
        """The part from step `begin` on."""
        steps = slice(begin, begin + n_steps)
        compute = None if self.compute_share is None else self.compute_share[steps]
        requests = self.requests and _within(self.requests, begin * dt_s, n_steps * dt_s)
        return _Part(self.p_share[steps], compute, requests, self.clock and self.clock.later(begin * dt_s))

    def repeated(self, n_steps: int) -> _Part:
        """The part forwards and backwards in turn, without the requests."""
        p_share, compute = (
            None if values is None else np.resize(np.concatenate((values, values[::-1])), n_steps)
            for values in (self.p_share, self.compute_share)
        )
        assert p_share is not None
        return _Part(p_share, compute, None, None)


def _part(
    trace: PowerTrace, split: str, dt_s: float, bounds: tuple[float, float], needed: int, boost_share: float
) -> _Part:
    """The part of a recording between two shares of its time, at least `needed` steps long."""
    scaled = trace.as_share()
    if trace.rated_kw is None:
        scale = boost_share  # its peak stands for the highest draw there is
    else:
        scale, highest = 1.0, float(scaled.power_kw.max())
        if highest > boost_share + 1e-9:
            raise TraceError(
                f"trace {trace.name!r} rises to {highest:g} of its rating of {trace.rated_kw:g} kW; give a boost_share "
                "of at least that, or the right rating"
            )
        if boost_share > 1.0 and trace.compute_kw is not None:
            scaled = boosted_trace(scaled, boost_share)
    share = scaled.resample(dt_s) * scale
    first, last = (round(bound * len(share)) for bound in bounds)
    if last - first < needed and split != WHOLE:
        raise TraceError(
            f"trace {trace.name!r} lasts {trace.duration_s:g} s, of which the {split} split has "
            f"{(last - first) * dt_s:g} s, but {needed * dt_s:g} s are needed; give a recording of at least "
            f"{needed * dt_s / (bounds[1] - bounds[0]):.0f} s or a shorter episode (horizon); the split {WHOLE!r}, "
            "which dcgrid run, check, capacity and study use by default, has all of it and shares it with training"
        )
    compute = scaled.resample_compute(dt_s)
    if compute is not None:
        dynamic = share - IDLE_SHARE
        compute = np.divide(compute * scale, dynamic, out=np.zeros_like(share), where=dynamic > 0)
        compute = np.minimum(compute, 1.0)[first:last]
    requests = trace.requests
    if requests is not None:
        begin_s = float(trace.time_s[0]) + first * dt_s
        requests = _within(requests, begin_s, (last - first) * dt_s)
    clock = clock_of(trace)
    part = _Part(share[first:last], compute, requests, clock and clock.later(first * dt_s))
    return part if last - first >= needed else part.repeated(last - first + needed)


def _within(requests: RequestTimes, begin_s: float, duration_s: float) -> RequestTimes:
    """Return the requests that arrive in an interval, with times from its beginning."""
    first, last = np.searchsorted(requests.arrival_s, (begin_s, begin_s + duration_s))
    arrival_s, *delays = (times[first:last] for times in requests)
    return RequestTimes(arrival_s - begin_s, *delays)


def _pool(rows: Sequence[FloatArray], n_steps: int) -> FloatArray:
    pool = np.array([np.pad(row, (0, n_steps - len(row)), "edge") for row in rows])
    pool.setflags(write=False)
    return pool


def _whole_recordings(traces: Sequence[PowerTrace], split: str) -> Sequence[PowerTrace]:
    """Return the recordings of a split: at least one for each, the rest in the shares of the splits, in order."""
    n = len(traces)
    if n < len(SPLITS):
        raise TraceError(
            f"by='recording' needs at least {len(SPLITS)} recordings, one a split, and got {n}; "
            "give more, or cut them by time"
        )
    test = max(1, round(0.2 * n))
    validation = max(1, round(0.2 * n))
    bounds = {
        "train": (0, n - validation - test),
        "validation": (n - validation - test, n - test),
        "test": (n - test, n),
    }
    low, high = bounds[split]
    return traces[low:high]
