"""Times that are numbers: their unit, from the name of the column and from their size."""

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError
from dcgrid_env.traces.text.power_unit import bracketed, last_word, word_unit

EPOCH_S = (1.2e9, 2.6e9)
"""Times in s since 1970 that are believed: the years 2008 to 2052."""
PARTS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
"""Units of times since 1970, as numbers in a second; their ranges do not overlap."""
_LONGER_S = {"min": 60.0, "h": 3600.0, "d": 86400.0}
_UNITS = {
    "s": re.compile(r"s(?:ec(?:ond)?s?)?"),
    "ms": re.compile(r"m(?:illi)?s(?:ec(?:ond)?s?)?"),
    "us": re.compile(r"(?:[u\u03bc]|micro)s(?:ec(?:ond)?s?)?"),
    "ns": re.compile(r"n(?:ano)?s(?:ec(?:ond)?s?)?"),
    "min": re.compile(r"m(?:in(?:ute)?s?)?"),
    "h": re.compile(r"h(?:(?:ou)?rs?)?"),
    "d": re.compile(r"d(?:ays?)?"),
}
"""Units in the names of columns, as `casefold` leaves them."""
_TIMES = re.compile(r"time|date|epoch|unix|elapsed|(?:ts?|s|sec|seconds?|minutes?|hours?|days?)(?![a-z])")
"""Begins of the names of columns of times."""


def named_unit(header: str) -> str | None:
    """Return the unit of time that the name of a column contains in brackets or as its last word."""
    for word in (bracketed(header)[0].casefold(), last_word(header).casefold()):
        for unit, pattern in _UNITS.items():
            if pattern.fullmatch(word):
                return unit
    return None


def is_time_name(header: str) -> bool:
    """Return whether the name of a column is one of times, and not of power."""
    return _TIMES.match(header.strip().casefold()) is not None and word_unit(last_word(header)) is None


def epoch_unit(time: float) -> str | None:
    """Return the unit in which a number is a time since 1970; None if it is none."""
    low, high = EPOCH_S
    return next((unit for unit, per_s in PARTS.items() if low <= time / per_s < high), None)


class Clock(NamedTuple):
    """Unit of the times of a file."""

    unit: str
    is_epoch: bool
    """Whether the times count from 1970."""

    def seconds(self, times: FloatArray, where: Callable[[int], str]) -> FloatArray:
        """Return times in s; raise TraceError for one that its unit does not allow.

        Parameters
        ----------
        times : (n,) float64; NaN and infinity stay.
        where : index -> text that begins the message, for example "file.csv, line 7".
        """
        seconds = times / PARTS[self.unit] if self.unit in PARTS else times * _LONGER_S[self.unit]
        limit_s = EPOCH_S[1] if self.is_epoch else EPOCH_S[0]
        for i in np.flatnonzero(np.isfinite(seconds) & (seconds >= limit_s))[:1]:
            begin = "1970" if self.is_epoch else "the beginning"
            raise TraceError(
                f"{where(int(i))}: the time {times[i]:.15g} is too large for {self.unit} since {begin}; give all times "
                "in one unit, from the beginning or in s, ms, us or ns since 1970"
            )
        return seconds


def clock_of(first: float, where: str, header: str = "") -> Clock:
    """Return the unit of the times of a file.

    Times since 1970 have the unit that their size shows. Other times have the unit in the column's name, and are in s
    without one.

    Parameters
    ----------
    first : first time of the file.
    where : text that begins a message, for example "file.csv, line 7".
    header : name of the column; "" if it has none.

    Raises
    ------
    TraceError
        If the name and the size contradict each other.
    """
    named, shown = named_unit(header), epoch_unit(first)
    if named is not None and shown not in (None, named):
        raise TraceError(
            f"{where}: the time is {first:.15g}, which is in {shown} since 1970, but the name {header!r} says {named}; "
            "correct the name, or count the times from the beginning"
        )
    return Clock(shown or named or "s", shown is not None)


def clock_text(time_s: float) -> str:
    """Text of a time since 1970, s, in UTC, to the millisecond."""
    return str(np.datetime64(round(time_s * 1e3), "ms"))
