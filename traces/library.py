"""Rows of power of a named source, split into train, validation and test.

The splits of a source share no seed, and those made of requests no day. A fourth, `ood`, is out of distribution:
another GPU type or service.
"""

from functools import lru_cache
from operator import index

import numpy as np

from dcgrid_env.traces.boost import boosted_trace
from dcgrid_env.traces.grid import GRID_S, IDLE_SHARE, grid_steps
from dcgrid_env.traces.rows import ALL_SPLITS, OUT_OF_DISTRIBUTION, SPLITS, TraceRows, known_boost, known_split
from dcgrid_env.traces.sources import TRACE_SOURCES
from dcgrid_env.traces.trace import TraceError, require_positive, steps_in

# Seeds of a split begin here; a library has fewer rows than the distance, so splits share no seed.
_SEEDS_PER_SPLIT = 1_000_000


def row_seed(split: str, row: int) -> int:
    """Return the generator seed of a row of a split; no two splits share one."""
    return ALL_SPLITS.index(known_split(split)) * _SEEDS_PER_SPLIT + row


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
    return _generated(source, known_split(split), dt_s, duration_s, index(count), known_boost(boost_share))


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
    requests, provenance = [], []
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
        provenance.append(trace.provenance)
    np.minimum(compute, 1.0, out=compute)
    power.setflags(write=False)
    compute.setflags(write=False)
    return TraceRows(power, compute, tuple(requests), tuple(provenance))
