"""Load profiles: a table with a column of power for each load, bus or class, on an even grid of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import date, timedelta

import numpy as np
from numpy.typing import ArrayLike

from dcgrid_env.core.magnitudes import LARGEST, wrong_magnitude
from dcgrid_env.traces.checks import FloatArray, TraceError

LEAST_STEP_S, MOST_STEP_S = 1.0, 3600.0
"""Shortest and longest time between two samples, s."""
DAY_H = 24.0
_ROUNDING = 1e-6
"""Share of a step by which a time may be off the grid."""


@dataclass(frozen=True, eq=False)
class ProfileTable:
    """Samples of several profiles at the same times; the arrays are read-only.

    Raises
    ------
    TraceError
        For a value that is not finite or repeated names; the message names the column, the row and the value.
    """

    begin_h: float
    """Time of the first sample, h since the midnight before it, in [0, 24)."""
    step_s: float
    """Time between two samples, s."""
    names: tuple[str, ...]
    """Names of the columns."""
    values: FloatArray
    """Samples, (sample, column); their unit is defined by who uses the table."""
    first_day: str = ""
    """Date of the first sample, ISO 8601; "" if the times are not dates."""
    utc_offset_h: float | None = None
    """UTC offset of the first sample, h; None if the times state none."""
    clock_changes: tuple[tuple[float, float], ...] = ()
    """Changes of the file's clock to and from summer time: time of each, h since the midnight before the first sample,
    and by how much the clock is ahead of that of the first sample from then on, h."""

    def __post_init__(self) -> None:
        values = np.array(self.values, np.float64)
        values.setflags(write=False)
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "names", tuple(self.names))
        if len(set(self.names)) < len(self.names):
            twice = next(name for name in self.names if self.names.count(name) > 1)
            raise TraceError(f"load profiles: column {twice!r} is there twice; give each column one name")
        if values.ndim != 2 or values.shape[1] != len(self.names) or len(values) < 1:
            raise TraceError(
                f"load profiles: values have shape {values.shape}; give (sample, {len(self.names)}), a column a name"
            )
        if not LEAST_STEP_S <= self.step_s <= MOST_STEP_S:
            raise TraceError(
                f"load profiles: the step is {self.step_s:g} s; give samples {LEAST_STEP_S:g} s to {MOST_STEP_S:g} s "
                "apart"
            )
        if not 0.0 <= self.begin_h < DAY_H:
            raise TraceError(f"load profiles: begin_h is {self.begin_h!r}; give an hour from 0 to less than 24")
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            row, column = bad[0]
            raise TraceError(
                f"load profiles: row {row}, column {self.names[column]!r}: the value is {values[row, column]}; give a "
                "finite number"
            )

    @property
    def asked_by(self) -> str | None:
        """Absolute path of the file that it was read from; None if it was made otherwise."""
        return self.__dict__.get("_asked_by")

    @property
    def label(self) -> str:
        """Name of the file for messages."""
        return self.asked_by or "load profiles"

    @property
    def duration_h(self) -> float:
        """Time that the samples cover, each for one step, h."""
        return len(self.values) * self.step_s / 3600.0

    @property
    def n_days(self) -> int:
        """Number of days that the samples touch."""
        return math.ceil((self.begin_h + self.duration_h) / DAY_H - 1e-9)

    def time_text(self, hour: float) -> str:
        """Return the date, or the number of the day from 1, and the time of day.

        Parameters
        ----------
        hour : time, h since the midnight before the first sample.
        """
        day, minutes = divmod(round(60.0 * float(self.clock_h(np.array([hour]))[0])), 1440)
        dated = date.fromisoformat(self.first_day) + timedelta(days=day) if self.first_day else None
        return f"{dated.isoformat() if dated else f'day {day + 1}'} {minutes // 60:02d}:{minutes % 60:02d}"

    def clock_h(self, hour: FloatArray) -> FloatArray:
        """Return what the file's clock shows at times, h since the midnight before the first sample."""
        changes_h, ahead_h = zip((-np.inf, 0.0), *self.clock_changes, strict=True)
        return hour + np.array(ahead_h)[np.searchsorted(changes_h, hour + 1e-9, side="right") - 1]

    def values_at(self, hour: FloatArray, *, linear: bool, repeat: bool) -> FloatArray:
        """Return the values at times, (row, column).

        Parameters
        ----------
        hour
            Times, h since the midnight before the first sample, (row,).
        linear
            Whether values are linear between two samples. Otherwise a sample holds until the next one.
        repeat
            Whether the table begins again after its end. Otherwise its last sample holds.
        """
        n = len(self.values)
        position = (hour - self.begin_h) * (3600.0 / self.step_s)
        first = np.floor(position + _ROUNDING)
        index = first.astype(np.int64)
        if repeat:
            index_now, index_next = index % n, (index + 1) % n
        else:
            index_now, index_next = np.clip(index, 0, n - 1), np.clip(index + 1, 0, n - 1)
        values = self.values[index_now]
        if linear:
            part = np.maximum(position - first, 0.0)[:, None]
            values = values + part * (self.values[index_next] - values)
        return values


def checked_table(
    file: str,
    times_s: ArrayLike,
    names: Sequence[str],
    values: FloatArray,
    where: Callable[[int], str],
    said: Callable[[int, int], object],
    day: str = "",
) -> ProfileTable:
    """Return the table of a file's samples.

    Parameters
    ----------
    file
        Name of the file for messages.
    times_s
        Times from the midnight before the first day or another midnight, s, (sample,).
    names, values
        Columns and samples, (sample, column).
    where
        Function that returns the place of a sample, such as "line 7".
    said
        Function that returns the text of a cell by sample and column.
    day
        Date of the first sample, ISO 8601; "" if not known.

    Raises
    ------
    TraceError
        For a gap, times that repeat or go back, another step than 1 s to 1 h, or a value that is not finite or
        larger than any load.
    """
    times = np.asarray(times_s, np.float64)
    if len(times) < 2:
        raise TraceError(f"{file}: it has {len(times)} samples; give at least 2")
    steps = np.diff(times)
    for i in np.flatnonzero(steps <= 0.0)[:1]:
        how = "repeats the time before it" if steps[i] == 0.0 else "is before the time of the sample before it"
        raise TraceError(
            f"{file}, {where(i + 1)}, column 'time': it {how}; sort the samples by time, one at each, or give UTC "
            "offsets to local times"
        )
    step_s = float(np.median(steps))
    if not LEAST_STEP_S - 1e-9 <= step_s <= MOST_STEP_S + 1e-9:
        raise TraceError(
            f"{file}, column 'time': the samples are {step_s:g} s apart; give {LEAST_STEP_S:g} s to {MOST_STEP_S:g} s"
        )
    for i in np.flatnonzero(np.abs(steps - step_s) > _ROUNDING * step_s * max(1.0, len(times) * 1e-3))[:1]:
        raise TraceError(
            f"{file}, {where(i + 1)}, column 'time': {steps[i]:g} s after the sample before it, and the others are "
            f"{step_s:g} s apart; fill the gap, or give samples at even times"
        )
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, column = bad[0]
        raise TraceError(
            f"{file}, {where(int(row))}, column {names[column]!r}: the value is {said(int(row), int(column))!r}; give "
            "a finite number"
        )
    sizes = np.abs(values)
    if sizes.max(initial=0.0) > LARGEST["kw"]:
        row, column = divmod(int(np.argmax(sizes)), sizes.shape[1])
        raise TraceError(
            f"{file}, {where(row)}, column {names[column]!r}: the value is {said(row, column)!r}; "
            f"{wrong_magnitude('kw', float(values[row, column]))}"
        )
    begin_h = float(times[0] % 86400.0) / 3600.0
    return ProfileTable(begin_h, step_s, tuple(names), values, day)
