"""What a scenario draws from: rows of power of a named source, split into train, validation and test.

The splits of a source share no seed, and those made of requests no day. A fourth, `ood`, is out of distribution:
another GPU type or service. Recordings are cut in time, or given out whole.

A row is one site's power as a share of its rating on a grid of dt. An episode of W steps takes the window
`rows.p_share[i, offset : offset + W]` at any offset in [0, n_steps - W].
"""

from collections.abc import Sequence
from functools import lru_cache
from operator import index
from typing import NamedTuple

import numpy as np

from dcgrid_env.traces.boost import boosted_trace
from dcgrid_env.traces.grid import GRID_S, IDLE_SHARE, grid_steps
from dcgrid_env.traces.sources import TRACE_SOURCES
from dcgrid_env.traces.trace import FloatArray, PowerTrace, RequestTimes, TraceError, require_positive, steps_in

SPLITS = ("train", "validation", "test")
OUT_OF_DISTRIBUTION = "ood"
ALL_SPLITS = (*SPLITS, OUT_OF_DISTRIBUTION)

# Seeds of a split begin here; a library has fewer rows than the distance, so splits share no seed.
_SEEDS_PER_SPLIT = 1_000_000

# Shares of a recording's time, train 60 %, validation 20 %, test 20 %, as bounds.
_SPLIT_BOUNDS = {"train": (0.0, 0.6), "validation": (0.6, 0.8), "test": (0.8, 1.0)}


class TraceRows(NamedTuple):
    """Rows of power on a grid of dt; arrays are read-only."""

    p_share: FloatArray
    """Share of rating, (count, n_steps) float64."""
    compute_share: FloatArray | None
    """Share of the power above the idle floor that does work whose speed follows the clock, in [0, 1], (count, n_steps)
    float64; None where nobody knows (recordings)."""
    requests: tuple[RequestTimes, ...] = ()
    """The requests behind each row, times from the row's beginning; () unless the source is made of requests."""


def row_seed(split: str, row: int) -> int:
    """Return the generator seed of a row of a split; no two splits share one."""
    return ALL_SPLITS.index(_known_split(split)) * _SEEDS_PER_SPLIT + row


def library(
    source: str, split: str, dt_s: float, duration_s: float, count: int = 24, boost_share: float = 1.0
) -> TraceRows:
    """Return generated rows of power; the same arguments always give the same bytes.

    Parameters
    ----------
    source : one of TRACE_SOURCES.
    split : "train", "validation" or "test", of which no two share a seed, or "ood".
    dt_s : step, s; at least the 0.1 s at which traces are generated.
    duration_s : length of a row, s.
    count : number of rows; the first rows do not depend on it.
    boost_share : highest short draw as a share of the rating, at least 1; see `dcgrid_env.traces.boost`.

    Returns
    -------
    TraceRows of (count, n_steps), n_steps = floor(duration_s / dt_s)

    Raises
    ------
    TraceError
        For an unknown source or split, or a number out of range.
    """
    if source not in TRACE_SOURCES:
        raise TraceError(f"trace source {source!r} is unknown; choose one of {', '.join(TRACE_SOURCES)}")
    dt_s = require_positive(dt_s, "dt_s", "give a step in seconds")
    if dt_s < GRID_S * (1 - 1e-9):
        raise TraceError(
            f"dt_s = {dt_s:g} is below the {GRID_S:g} s at which traces are generated; "
            f"choose dt_s >= {GRID_S:g} or supply recordings (from_recordings)"
        )
    duration_s = require_positive(duration_s, "duration_s", "give the length of a row in seconds")
    if steps_in(duration_s, dt_s) < 1:
        raise TraceError(f"duration_s = {duration_s:g} is shorter than one step of {dt_s:g} s; give a longer one")
    if not 1 <= index(count) <= _SEEDS_PER_SPLIT:
        raise TraceError(f"count = {count!r} is not in 1 to {_SEEDS_PER_SPLIT}")
    return _generated(source, _known_split(split), dt_s, duration_s, index(count), _known_boost(boost_share))


@lru_cache(maxsize=32)
def _generated(source: str, split: str, dt_s: float, duration_s: float, count: int, boost_share: float) -> TraceRows:
    n_steps, n_grid = steps_in(duration_s, dt_s), grid_steps(duration_s)
    generate = TRACE_SOURCES[source].generate
    if split == OUT_OF_DISTRIBUTION:
        shifted = TRACE_SOURCES[source].shifted
        if shifted is None:
            raise TraceError(f"trace source {source!r} has no split {split!r}; choose one of {', '.join(SPLITS)}")
        generate = shifted
    power, compute = np.empty((count, n_steps)), np.zeros((count, n_steps))
    requests = []
    for row in range(count):
        trace = generate(n_grid * GRID_S, row_seed(split, row))
        assert trace.compute_kw is not None  # every generator tells
        if boost_share > 1.0:
            trace = boosted_trace(trace, boost_share)
        power[row] = trace.resample(dt_s)[:n_steps]
        compute_kw = trace.resample_compute(dt_s)
        assert compute_kw is not None
        dynamic = power[row] - IDLE_SHARE
        np.divide(compute_kw[:n_steps], dynamic, out=compute[row], where=dynamic > 0)
        requests += [trace.requests] if trace.requests is not None else []
    np.minimum(compute, 1.0, out=compute)
    power.setflags(write=False)
    compute.setflags(write=False)
    return TraceRows(power, compute, tuple(requests))


def from_recordings(
    traces: Sequence[PowerTrace],
    split: str,
    dt_s: float,
    window_s: float = 0.0,
    boost_share: float = 1.0,
    by: str = "time",
) -> TraceRows:
    """Return rows of power from recordings, each as a share of its own peak.

    The first 60 % train, the next 20 % validate, the last 20 % test: of each recording's time, or of the recordings in
    their order. A row is as long as the shortest part; a longer part gives several rows that together cover it,
    overlapping if need be.

    Parameters
    ----------
    traces : at least one recording.
    split : "train", "validation" or "test"; no two share a sample.
    dt_s : step, s.
    window_s : the longest window that will be taken, s; 0 if not known yet.
    boost_share : the peak of each recording as a share of the rating, at least 1.
    by : "time" cuts each recording, "recording" gives whole recordings to the splits and needs at least 3.

    Returns
    -------
    TraceRows of (count, n_steps)

    Raises
    ------
    TraceError
        If there is no recording, or a recording's part of the split is shorter than one step or `window_s`.
    """
    if _known_split(split) == OUT_OF_DISTRIBUTION:
        raise TraceError(
            "recordings have no split 'ood'; give recordings of another GPU or service as the trace instead"
        )
    low, high = _SPLIT_BOUNDS[split]
    if not traces:
        raise TraceError("from_recordings got no trace; give at least one PowerTrace")
    if not (np.isfinite(window_s) and window_s >= 0):
        raise TraceError(f"window_s = {window_s!r} is not a finite number of at least 0; give a length in seconds")
    needed = max(1, -steps_in(-window_s, require_positive(dt_s, "dt_s", "give a step in seconds")))
    boost_share = _known_boost(boost_share)
    if by == "recording":
        traces, low, high = _whole_recordings(traces, split), 0.0, 1.0
    elif by != "time":
        raise TraceError(f"by = {by!r} is unknown; cut recordings by time or give them out by recording")
    parts = []
    for trace in traces:
        share = trace.as_share().resample(dt_s) * boost_share
        part = share[round(low * len(share)) : round(high * len(share))]
        if len(part) < needed:
            raise TraceError(
                f"trace {trace.name!r} lasts {trace.duration_s:g} s, of which the {split} split has "
                f"{len(part) * dt_s:g} s, but {needed * dt_s:g} s are needed; give a recording of at least "
                f"{needed * dt_s / (high - low):.0f} s or a shorter episode"
            )
        parts.append(part)
    n_steps = min(map(len, parts))
    rows = []
    for part in parts:
        begins = np.linspace(0, len(part) - n_steps, -(-len(part) // n_steps)).astype(int)
        rows += [part[begin : begin + n_steps] for begin in begins]
    pool = np.array(rows)
    pool.setflags(write=False)
    return TraceRows(pool, None)


def require_window(rows: TraceRows, n_steps: int, dt_s: float, name: str) -> None:
    """Raise TraceError unless a window of `n_steps` fits into the rows of the source `name`."""
    if rows.p_share.shape[-1] < n_steps:
        raise TraceError(
            f"trace {name!r} lasts {rows.p_share.shape[-1] * dt_s:g} s but the episode needs {n_steps * dt_s:g} s "
            f"({n_steps} steps of {dt_s:g} s); give a longer trace or a shorter episode"
        )


def _whole_recordings(traces: Sequence[PowerTrace], split: str) -> Sequence[PowerTrace]:
    """The recordings of a split: at least one for each, the rest in the shares of the splits, in their order."""
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


def _known_boost(boost_share: float) -> float:
    if not (np.isfinite(boost_share) and 1.0 <= boost_share <= 2.0):
        raise TraceError(
            f"boost_share = {boost_share!r} is not in 1 to 2; give the highest draw as a share of the rating"
        )
    return float(boost_share)


def _known_split(split: str) -> str:
    if split not in ALL_SPLITS:
        raise TraceError(f"split {split!r} is unknown; choose one of {', '.join(ALL_SPLITS)}")
    return split
