"""Intervals between the samples of a recording, for each of its meters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dcgrid_env.traces.checks import FloatArray

GAP_INTERVALS = 3.0
"""Samples further apart than this many usual intervals have a gap between them."""


@dataclass(frozen=True)
class Sampling:
    """Intervals between the samples of a meter; of several meters, those of the one with the longest gaps."""

    interval_s: float
    """Usual interval between samples, the median, s; of several meters, the median of theirs."""
    jitter_s: float
    """Deviation from the usual interval that 95 % of the intervals outside gaps do not exceed, s."""
    gaps: int
    longest_gap_s: float
    gap_s: float
    """Time in gaps, s."""
    meter: str = ""
    """Meter with the gaps; "" if there is one meter or no gap."""
    meters: int = 1


def sampling_of(times_s: Mapping[str, FloatArray]) -> Sampling:
    """Return the sampling of meters.

    Parameters
    ----------
    times_s : times of the samples of each meter by name, (n,) float64 each, s; at least one meter has two samples.
    """
    samplings = {meter: _of_one(times) for meter, times in times_s.items() if len(times) > 1}
    worst = max(samplings, key=lambda meter: samplings[meter].gap_s)
    return Sampling(
        interval_s=float(np.median([sampling.interval_s for sampling in samplings.values()])),
        jitter_s=float(np.median([sampling.jitter_s for sampling in samplings.values()])),
        gaps=samplings[worst].gaps,
        longest_gap_s=samplings[worst].longest_gap_s,
        gap_s=samplings[worst].gap_s,
        meter=worst if len(times_s) > 1 and samplings[worst].gaps else "",
        meters=len(times_s),
    )


def _of_one(time_s: FloatArray) -> Sampling:
    interval_s = np.diff(time_s)
    usual_s = float(np.median(interval_s))
    is_gap = interval_s > GAP_INTERVALS * usual_s
    return Sampling(
        interval_s=usual_s,
        jitter_s=float(np.quantile(np.abs(interval_s[~is_gap] - usual_s), 0.95)),
        gaps=int(is_gap.sum()),
        longest_gap_s=float(interval_s[is_gap].max(initial=0.0)),
        gap_s=float(interval_s[is_gap].sum()),
    )
