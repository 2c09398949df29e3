"""Local times with changes to and from summer time, as times that pass.

Files in local time lack the hour that the clock skips in spring, and contain the hour that it repeats in autumn twice.
Such a change is recognised by its day and hour: clocks change on Sundays, at 0 to 4 o'clock, in spring and autumn. An
hour that is missing at any other time is a gap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError

HOUR_S = 3600.0
_LONGEST_DAYS = 250
"""Longest summer time, days; that of North America lasts 238."""
_MONTHS = (3, 4, 5, 8, 9, 10, 11)
"""Months in which clocks change somewhere in the world."""
_SUNDAY = 6
_LATEST_H = 5
"""Latest hour of the first sample after a change, in the time before the change."""


def elapsed_s(dates: Sequence[datetime], refuse: Callable[[int, str], TraceError]) -> FloatArray:
    """Return the times that pass from the first date to each one, s, (sample,).

    The clock of the first date holds for all: after a change to summer time, times are an hour less than in the file.

    Parameters
    ----------
    dates
        Local dates without UTC offset, in the order of the samples.
    refuse
        Function that returns the error for a sample and a remedy.

    Raises
    ------
    TraceError
        If the clock is set forward or back twice in a row, or if the file contains one change of a year alone.
    """
    wall = np.array([(date - dates[0]).total_seconds() for date in dates])
    steps = np.diff(wall)
    if not len(steps):
        return wall
    step_s = float(np.median(steps))
    shift_s = np.zeros_like(wall)
    last: tuple[int, float] | None = None
    for i in np.flatnonzero(np.abs(np.abs(steps - step_s) - HOUR_S) < 1e-6 * step_s).tolist():
        change_s = HOUR_S if steps[i] > step_s else -HOUR_S
        if not _is_change(dates[i + 1], change_s):
            continue
        # Summer time is on before the clock is set back, and after it is set forward.
        begin = 0 if last is None else last[0]
        is_twice = last is not None and last[1] == change_s
        if is_twice or (change_s < 0.0 and (dates[i] - dates[begin]).days > _LONGEST_DAYS):
            raise refuse(i + 1, _remedy(change_s))
        shift_s[i + 1 :] -= change_s
        last = i + 1, change_s
    if last and last[1] > 0.0 and (dates[-1] - dates[last[0]]).days > _LONGEST_DAYS:
        raise refuse(last[0], _remedy(HOUR_S))
    return wall + shift_s


def _is_change(first: datetime, change_s: float) -> bool:
    """Whether a sample may be the first one after the clock was set forward or back by an hour."""
    before = first - timedelta(seconds=change_s)
    is_early = before.hour + before.minute / 60.0 + before.second / HOUR_S <= _LATEST_H
    return before.weekday() == _SUNDAY and before.month in _MONTHS and is_early


def _remedy(change_s: float) -> str:
    missing, other = (
        ("skips an hour", "repeats none in autumn") if change_s > 0.0 else ("repeats an hour", "skips none")
    )
    return (
        f"the file {missing} there as clocks do, but {other} within {_LONGEST_DAYS} days; give UTC offsets, or local "
        "times with both changes"
    )
