"""Readings of several meters, such as the GPUs of a node, checked one by one and summed on a common time axis."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive
from dcgrid_env.traces.text.gaps import GAP_RULES, GapRule
from dcgrid_env.traces.text.power_unit import KW_PER_UNIT, require_unit

USUAL_DISTANCES = 5.0
LEAST_GAP_S = 15.0
"""By default, readings are a gap apart from this time on, and from USUAL_DISTANCES times their usual distance on, s."""


@dataclass
class Meter:
    """Readings of one meter, in the order of the file."""

    name: str
    time_s: array = field(default_factory=lambda: array("d"))
    power_kw: array = field(default_factory=lambda: array("d"))
    place: array = field(default_factory=lambda: array("q"))
    """Place of each reading in the file: a line, or the number of a value."""


class Meters:
    """Readings of the meters of a file.

    Parameters
    ----------
    file : name of the file in messages.
    field : name of the power column or metric in messages.
    unit : unit of the readings: "W", "kW", "MW" or "mW".
    max_gap_s, gaps : rule for readings of a meter that are far apart, see `GapRule`. None for `max_gap_s` is five times
        the median distance of the meter's readings, at least 15 s.
    limit_kw : highest accepted reading, kW.
    placed : meter and place of a reading -> text that begins a message, for example "power.log, line 7: GPU 3".

    Raises TraceError for a rule or a limit that is out of range.
    """

    def __init__(
        self,
        file: str,
        field: str,
        unit: str,
        *,
        max_gap_s: float | None,
        gaps: str,
        limit_kw: float,
        placed: Callable[[str, int], str],
    ) -> None:
        require_unit(file, unit)
        if gaps not in GAP_RULES:
            raise TraceError(f"gaps = {gaps!r} is unknown; choose one of {', '.join(GAP_RULES)}")
        if max_gap_s is not None:
            require_positive(max_gap_s, "max_gap_s", "give the longest distance between readings in s, or None")
        self.meters: dict[str, Meter] = {}
        self._file, self._field, self._kw, self._placed = file, field, KW_PER_UNIT[unit], placed
        self._limit_kw = require_positive(limit_kw, "limit_kw", "give the highest reading in kW")
        self._max_gap_s, self._gaps = max_gap_s, gaps

    def add(self, meter: str, time_s: float, reading: float, place: int) -> None:
        """Append a reading in the unit of the file; a reading that is not a number is missing and left out.

        Raises TraceError for a time that is not finite, a negative reading, and one above the limit.
        """
        if not math.isfinite(time_s):
            raise TraceError(f"{self._placed(meter, place)}: the time is {time_s}; repair or remove the reading")
        if math.isnan(reading):
            self.meters.setdefault(meter, Meter(meter))
            return
        power_kw = reading * self._kw
        if not 0.0 <= power_kw <= self._limit_kw:
            remedy = "power is consumption and not negative: check the sign and the column"
            if power_kw > 0:
                remedy = f"above limit_kw = {self._limit_kw:g}; is the unit right? If so, raise limit_kw"
            raise TraceError(f"{self._placed(meter, place)}: {self._field} is {power_kw:g} kW, {remedy}")
        found = self.meters.setdefault(meter, Meter(meter))
        found.time_s.append(time_s)
        found.power_kw.append(power_kw)
        found.place.append(place)

    def total(self) -> tuple[FloatArray, FloatArray, float]:
        """Sum of the meters from the first instant at which all have reported to the last reading of any.

        Returns
        -------
        time_s, power_kw : (n,) float64 each, times from 0.
        begin_s : the file's clock at time 0, s.

        Raises
        ------
        TraceError
            For a file without readings, a meter that never reports, times of a meter that repeat or go back, and a gap.
        """
        silent = next((meter.name for meter in self.meters.values() if not meter.time_s), None)
        if not self.meters or silent is not None:
            what = "no reading" if silent is None else f"no reading of {silent}"
            raise TraceError(f"{self._file}: has {what} of {self._field}; export the readings, or leave the meter out")
        ends_s = [(meter.time_s[0], meter.time_s[-1]) for meter in self.meters.values()]
        first_s, last_s = min(begin for begin, _ in ends_s), max(end for _, end in ends_s)
        filled = [self._filled(meter, first_s, last_s) for meter in self.meters.values()]
        time_s, power_kw = held_total(filled)
        if len(time_s) < 2:
            raise TraceError(
                f"{self._file}: {len(time_s)} readings from when all {len(filled)} meters have reported; give at least "
                "2 (a reading holds until the next)"
            )
        return time_s - time_s[0], power_kw, float(time_s[0])

    def _filled(self, meter: Meter, first_s: float, last_s: float) -> tuple[FloatArray, FloatArray]:
        """Readings of a meter with its gaps treated."""
        time_s, power_kw = np.array(meter.time_s), np.array(meter.power_kw)
        distance_s = np.diff(time_s)
        back = np.flatnonzero(distance_s <= 0)
        if back.size:
            place = meter.place[int(back[0]) + 1]
            fault = "repeats the time" if distance_s[back[0]] == 0 else f"comes {-distance_s[back[0]]:g} s before that"
            raise TraceError(
                f"{self._placed(meter.name, place)}: {fault} of the reading above; sort the readings by time, or "
                "export a column or label that tells the meters apart"
            )
        usual_s = float(np.median(distance_s)) if len(distance_s) else 0.0
        rule = GapRule(self._max_gap_s or max(LEAST_GAP_S, USUAL_DISTANCES * usual_s), self._gaps)
        for edge, which, distance in ((0, "first", time_s[0] - first_s), (-1, "last", last_s - time_s[-1])):
            if rule.refuses(distance):
                raise TraceError(
                    f"{self._placed(meter.name, meter.place[edge])}: its {which} reading is {distance:g} s from the "
                    f"{'beginning' if edge == 0 else 'end'} of the others, more than max_gap_s = {rule.max_gap_s:g}; "
                    "cut the file there, raise max_gap_s, or pass gaps='hold'"
                )
        return rule.apply(time_s, power_kw, lambda i: self._placed(meter.name, meter.place[i]))


def held_total(series: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Sum of series of samples that hold until the next, on the union of their times.

    Parameters
    ----------
    series : time_s and power_kw of each, (n_i,) float64, times increasing.

    Returns
    -------
    time_s, power_kw : (n,) float64, from the first instant at which every series has a sample to the last of any
    """
    begin_s = max(time_s[0] for time_s, _ in series)
    time_s = np.unique(np.concatenate([time_s for time_s, _ in series]))
    time_s = time_s[time_s >= begin_s]
    power_kw = np.zeros_like(time_s)
    for times_s, values_kw in series:
        power_kw += values_kw[np.searchsorted(times_s, time_s, side="right") - 1]
    return time_s, power_kw


def clock_text(time_s: float) -> str:
    """Text of a time since 1970, s, in UTC, to the millisecond."""
    return str(np.datetime64(round(time_s * 1e3), "ms"))


def one_of(names: Iterable[str], asked: str | None, where: str, option: str) -> str:
    """Return the name that a file has or that was asked for; raise TraceError if there are several or none."""
    found = sorted(set(names))
    if asked is not None:
        if asked not in found:
            raise TraceError(f"{where}: has no {asked!r}; it has {', '.join(found) or 'none'}: correct {option}")
        return asked
    if len(found) != 1:
        raise TraceError(f"{where}: has {', '.join(found) or 'no power'}; choose one with {option}")
    return found[0]
