"""Rows of power of a named source, split into train, validation and test.

The splits of a source share no seed, and those made of requests no day. A fourth, `ood`, is out of distribution:
another GPU type or service.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import index

import numpy as np

from dcgrid_env.core.suggestions import unknown
from dcgrid_env.traces.boost import boosted_trace
from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive, steps_in
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.rows import ALL_SPLITS, OUT_OF_DISTRIBUTION, SPLITS, TraceRows, checked_boost, checked_split
from dcgrid_env.traces.sources import TRACE_SOURCES
from dcgrid_env.traces.time_grid import GRID_S, IDLE_SHARE, grid_steps
from dcgrid_env.traces.trace import RequestTimes

# Seeds of a split begin here; a library has fewer rows than the distance, so splits share no seed.
_SEEDS_PER_SPLIT = 1_000_000


def row_seed(split: str, row: int) -> int:
    """Return the generator seed of a row of a split; no two splits share one."""
    return ALL_SPLITS.index(checked_split(split)) * _SEEDS_PER_SPLIT + row


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
    return _generated(checked(source, split, dt_s, duration_s, count, boost_share))


@dataclass(frozen=True)
class Law:
    """Settings that generate a library's rows; see `library` for the fields."""

    source: str
    split: str
    dt_s: float
    duration_s: float
    count: int
    boost_share: float


def checked(source: str, split: str, dt_s: float, duration_s: float, count: int, boost_share: float) -> Law:
    """Check the arguments of `library`; raise TraceError for an invalid one."""
    if source not in TRACE_SOURCES:
        raise TraceError(unknown("trace source", source, TRACE_SOURCES, "`dcgrid list traces` lists all"))
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
    if checked_split(split) == OUT_OF_DISTRIBUTION and TRACE_SOURCES[source].shifted is None:
        raise TraceError(f"trace source {source!r} has no split {split!r}; choose one of {', '.join(SPLITS)}")
    return Law(source, split, dt_s, duration_s, index(count), checked_boost(boost_share))


def generated_row(law: Law, row: int) -> tuple[FloatArray, FloatArray, RequestTimes | None, Provenance]:
    """Generate a row: power and compute-bound share, (n_steps,) each, the requests behind it and its provenance."""
    source = TRACE_SOURCES[law.source]
    generate = source.shifted if law.split == OUT_OF_DISTRIBUTION else source.generate
    assert generate is not None  # `checked`
    n_steps, n_grid = steps_in(law.duration_s, law.dt_s), grid_steps(law.duration_s)
    trace = generate(n_grid * GRID_S, row_seed(law.split, row))
    if law.boost_share > 1.0:
        trace = boosted_trace(trace, law.boost_share)
    power, compute_kw = trace.resample(law.dt_s)[:n_steps], trace.resample_compute(law.dt_s)
    assert compute_kw is not None  # every generator provides it
    dynamic = power - IDLE_SHARE
    compute = np.divide(compute_kw[:n_steps], dynamic, out=np.zeros(n_steps), where=dynamic > 0)
    return power, np.minimum(compute, 1.0), trace.requests, trace.provenance


def row_hour(source: str, split: str, row: int) -> int | None:
    """Return the hour at which a row of a source with a daily profile begins; None for another source."""
    return row_seed(split, row) % 24 if TRACE_SOURCES[source].daily else None


@lru_cache(maxsize=32)
def _generated(law: Law) -> TraceRows:
    power, compute, requests, provenance = zip(*(generated_row(law, row) for row in range(law.count)), strict=True)
    present = tuple(drawn for drawn in requests if drawn is not None)
    return TraceRows(_read_only(power), _read_only(compute), present, provenance)


def _read_only(rows: Sequence[FloatArray]) -> FloatArray:
    array = np.array(rows)
    array.setflags(write=False)
    return array
