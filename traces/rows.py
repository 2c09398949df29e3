"""Rows of power that a scenario draws windows from, and the splits they belong to.

A row is one site's power as a share of its rating on a grid of dt. An episode of W steps takes the window
`rows.p_share[i, offset : offset + W]` at any offset in [0, n_steps - W].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.recording_clock import Clock
from dcgrid_env.traces.trace import RequestTimes

SPLITS = ("train", "validation", "test")
"""Splits of the same distribution."""
OUT_OF_DISTRIBUTION = "ood"
ALL_SPLITS = (*SPLITS, OUT_OF_DISTRIBUTION)
"""``SPLITS`` and the split that is out of distribution."""
WHOLE = "whole"
"""Split of answers on the user's files: all of each file, which it shares with the other splits."""


class TraceRows(NamedTuple):
    """Rows of power on a grid of dt; arrays are read-only."""

    p_share: FloatArray
    """Share of rating, (count, n_steps) float64."""
    compute_share: FloatArray | None
    """Share of the power above the idle floor that does work whose speed follows the clock, in [0, 1], (count, n_steps)
    float64; None where nobody knows (recordings of power)."""
    requests: tuple[RequestTimes, ...] = ()
    """The requests behind each row, times from the row's beginning; () unless the source is made of requests."""
    provenance: tuple[Provenance, ...] = ()
    """Where each row comes from."""
    clocks: tuple[Clock | None, ...] = ()
    """Clock at the beginning of each row; None for a recording without dates, and for a repeated one. () for generated
    rows."""
    row_steps: tuple[int, ...] = ()
    """Steps of each row that are recorded; the last value holds after them. () for generated rows."""


def require_window(rows: TraceRows, n_steps: int, dt_s: float, name: str) -> None:
    """Raise TraceError unless a window of `n_steps` fits into the rows of the source `name`."""
    if rows.p_share.shape[-1] < n_steps:
        raise TraceError(
            f"trace {name!r} lasts {rows.p_share.shape[-1] * dt_s:g} s but the episode needs {n_steps * dt_s:g} s "
            f"({n_steps} steps of {dt_s:g} s); give a longer trace or a shorter episode"
        )


def checked_boost(boost_share: float) -> float:
    """Return the share; raise TraceError unless it is in 1 to 2."""
    if not (np.isfinite(boost_share) and 1.0 <= boost_share <= 2.0):
        raise TraceError(
            f"boost_share = {boost_share!r} is not in 1 to 2; give the highest draw as a share of the rating"
        )
    return float(boost_share)


def checked_split(split: str) -> str:
    """Return the split; raise TraceError unless it is one of ALL_SPLITS."""
    if split not in ALL_SPLITS:
        raise TraceError(f"split {split!r} is unknown; choose one of {', '.join(ALL_SPLITS)}")
    return split
