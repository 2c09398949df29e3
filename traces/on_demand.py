"""Long rows of a generated source, made one by one when an episode first needs them.

A row of a day takes up to some ten seconds to generate, and an environment that runs one episode needs few of them.
"""

from __future__ import annotations

from functools import lru_cache
from threading import Lock

import numpy as np

from dcgrid_env.traces.checks import FloatArray, steps_in
from dcgrid_env.traces.library import checked, generated_row, row_hour
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.trace import RequestTimes


@lru_cache(maxsize=4)
def rows_on_demand(
    source: str, split: str, dt_s: float, duration_s: float, count: int, boost_share: float, spare_steps: int
) -> RowsOnDemand:
    """The rows of these arguments, so that scenarios alike share those that are made; the last few are kept."""
    return RowsOnDemand(source, split, dt_s, duration_s, count, boost_share, spare_steps)


class RowsOnDemand:
    """Rows as `TraceRows` has them, NaN until `make` is asked for them; the same arguments always give the same bytes.

    Parameters
    ----------
    source, split, dt_s, duration_s, count, boost_share
        See ``library``, whose rows these are.
    spare_steps
        Steps by which a window may begin later in a row than it must; kept for who draws windows.

    Attributes
    ----------
    p_share, compute_share
        Float64 of shape (count, n_steps).
    begin_h
        Time of day at which each row begins, h, (count,) float64; None for a source that does not follow the day.
    """

    def __init__(
        self, source: str, split: str, dt_s: float, duration_s: float, count: int, boost_share: float, spare_steps: int
    ):
        self._law = checked(source, split, dt_s, duration_s, count, boost_share)
        self.spare_steps = spare_steps
        n_steps = steps_in(duration_s, dt_s)
        self.p_share: FloatArray = np.full((count, n_steps), np.nan)
        self.compute_share: FloatArray = np.full((count, n_steps), np.nan)
        hours = [row_hour(source, split, row) for row in range(count)]
        self.begin_h = None if hours[0] is None else np.array(hours, np.float64)
        self._requests: dict[int, RequestTimes | None] = {}
        self._provenance: dict[int, Provenance] = {}
        self._lock = Lock()

    def make(self, rows: np.ndarray) -> None:
        """Generate those of these rows, of any shape, that have not been."""
        for row in np.unique(rows).tolist():
            with self._lock:
                if row not in self._provenance:
                    row_values = generated_row(self._law, row)
                    self.p_share[row], self.compute_share[row], self._requests[row], self._provenance[row] = row_values

    @property
    def requests(self) -> dict[int, RequestTimes]:
        """The requests behind the rows made so far, by row; empty where the source is not made of requests."""
        return {row: times for row, times in self._requests.items() if times is not None}

    @property
    def provenance(self) -> tuple[Provenance, ...]:
        """Where each of the rows made so far comes from, in their order."""
        return tuple(self._provenance[row] for row in sorted(self._provenance))
