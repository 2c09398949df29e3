"""Date and time of a recording's first sample, as its file states them."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, NamedTuple

from dcgrid_env.traces.trace import PowerTrace

BEGAN, UTC_OFFSET = "began", "utc_offset_h"
"""Parameters of a log's provenance: date and time of time 0, in UTC if the file states UTC offsets, and the offset of
its first time, h. The second is missing where the file states none, and the first is then the log's own clock."""
_STARTED = "started"
"""Date and time with a UTC offset that ``dcgrid traces record`` notes."""
_EPOCH_S = 946_684_800.0
"""Year 2000, s since 1970: times from it on are dates, those before it are counted from another begin."""


class Clock(NamedTuple):
    """Clock of a recording at one of its samples."""

    utc_s: float
    """Seconds since 1970 in UTC; without an offset, of the recording's own clock."""
    utc_offset_h: float | None
    """UTC offset that the file states, h; None if it states none."""

    def later(self, time_s: float) -> Clock:
        """Return the clock some seconds later."""
        return self._replace(utc_s=self.utc_s + time_s)

    def local_s(self, utc_offset_h: float | None) -> float:
        """Return the seconds since 1970 on the clock of a place with a UTC offset, h.

        If the offset of either is unknown, both are taken to be in one time zone.
        """
        if self.utc_offset_h is None:
            return self.utc_s
        return self.utc_s + 3600.0 * (self.utc_offset_h if utc_offset_h is None else utc_offset_h)


def clock_of(trace: PowerTrace) -> Clock | None:
    """Return the clock of a recording at its first sample; None if its file has no dates."""
    noted: dict[str, Any] = trace.provenance.parameters
    if isinstance(source := noted.get("source"), dict):  # a recording that was saved
        noted = {**source.get("parameters", {}), **noted}
    began_s, started_s, first_s = _utc_s(noted.get(BEGAN)), _utc_s(noted.get(_STARTED)), float(trace.time_s[0])
    offset_h = noted.get(UTC_OFFSET)
    if first_s >= _EPOCH_S:
        return Clock(first_s, 0.0)
    if began_s >= _EPOCH_S:
        return Clock(began_s + first_s, float(offset_h) if isinstance(offset_h, int | float) else None)
    return Clock(started_s + first_s, 0.0) if started_s >= _EPOCH_S else None


def _utc_s(text: object) -> float:
    """Seconds since 1970 of a date and time, which counts as UTC without an offset; 0 for anything else."""
    try:
        moment = datetime.fromisoformat(str(text))
    except ValueError:
        return 0.0
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
