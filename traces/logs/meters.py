"""Readings of several meters, such as the GPUs of a node, checked one by one and summed on a common time axis."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.sampling import GAP_INTERVALS, Sampling, sampling_of
from dcgrid_env.traces.text.gaps import GAP_RULES, meter_rule
from dcgrid_env.traces.text.power_limits import above_limit, limit_of, outlier, outlier_text
from dcgrid_env.traces.text.power_unit import KW_PER_UNIT, require_unit
from dcgrid_env.traces.trace import PowerTrace

ROUND_SHARE = 0.4
"""Longest duration of a round in which each meter reports once, as a share of the usual distance of the readings."""
COMPLETE_ROUNDS = 0.75
"""Least share of rounds in which all meters report."""


@dataclass
class Meter:
    """Readings of one meter, in the order of the file."""

    name: str
    limit_kw: float
    """Highest accepted reading, kW."""
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
    limit_kw : highest accepted reading, kW; by default that of `dcgrid_env.traces.text.power_limits`, which refuses
        outliers too.
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
        limit_kw: float | None,
        placed: Callable[[str, int], str],
    ) -> None:
        require_unit(file, unit)
        if gaps not in GAP_RULES:
            raise TraceError(f"gaps = {gaps!r} is unknown; choose one of {', '.join(GAP_RULES)}")
        if max_gap_s is not None:
            require_positive(max_gap_s, "max_gap_s", "give the longest distance between readings in s, or None")
        if limit_kw is not None:
            require_positive(limit_kw, "limit_kw", "give the highest reading in kW")
        self.meters: dict[str, Meter] = {}
        self._file, self._field, self._kw, self._placed = file, field, KW_PER_UNIT[unit], placed
        self._limit_kw, self._max_gap_s, self._gaps = limit_kw, max_gap_s, gaps

    def add(self, meter: str, time_s: float, reading: float, place: int) -> None:
        """Append a reading in the unit of the file; a reading that is not a number is missing and left out.

        Raises TraceError for a time that is not finite, a negative reading, and one above the limit.
        """
        if not math.isfinite(time_s):
            raise TraceError(f"{self._placed(meter, place)}: the time is {time_s}; repair or remove the reading")
        appended = self.meters.get(meter)
        if appended is None:
            limit_kw = limit_of(f"{self._field} {meter}", self._limit_kw)
            appended = self.meters[meter] = Meter(meter, limit_kw)
        if math.isnan(reading):
            return
        power_kw = reading * self._kw
        if not 0.0 <= power_kw <= appended.limit_kw:
            remedy = "power is consumption and not negative: check the sign and the column"
            if power_kw > 0:
                remedy = above_limit(appended.limit_kw)
            raise TraceError(f"{self._placed(meter, place)}: {self._field} is {power_kw:g} kW, {remedy}")
        appended.time_s.append(time_s)
        appended.power_kw.append(power_kw)
        appended.place.append(place)

    def total(self) -> Total:
        """Sum of the meters from the first instant at which all have reported to the last reading of any.

        Raises
        ------
        TraceError
            For a file without readings, a meter that never reports, times of a meter that repeat or go back, an
            outlier, and a gap.
        """
        silent = next((meter.name for meter in self.meters.values() if not meter.time_s), None)
        if not self.meters or silent is not None:
            missing = "no reading" if silent is None else f"no reading of {silent}"
            raise TraceError(
                f"{self._file}: has {missing} of {self._field}; export the readings, or leave the meter out"
            )
        ends_s = [(meter.time_s[0], meter.time_s[-1]) for meter in self.meters.values()]
        first_s, last_s = min(begin for begin, _ in ends_s), max(end for _, end in ends_s)
        summed = held_total({meter.name: self._filled(meter, first_s, last_s) for meter in self.meters.values()})
        if len(summed.time_s) < 2:
            raise TraceError(
                f"{self._file}: {len(summed.time_s)} readings from when all {len(self.meters)} meters have reported; "
                "give at least 2 (a reading holds until the next)"
            )
        return summed

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
        highest = outlier(power_kw) if self._limit_kw is None else None
        if highest is not None:
            raise TraceError(
                f"{self._placed(meter.name, meter.place[highest])}: {self._field} is "
                f"{outlier_text(power_kw[highest], float(np.median(power_kw)))}"
            )
        rule = meter_rule(self._max_gap_s, self._gaps, distance_s)
        for edge, which, distance in ((0, "first", time_s[0] - first_s), (-1, "last", last_s - time_s[-1])):
            if rule.refuses(distance):
                raise TraceError(
                    f"{self._placed(meter.name, meter.place[edge])}: its {which} reading is {distance:g} s from the "
                    f"{'beginning' if edge == 0 else 'end'} of the others, more than max_gap_s = {rule.max_gap_s:g}; "
                    "cut the file there, raise max_gap_s, or pass gaps='hold'"
                )
        return rule.apply(time_s, power_kw, lambda i: self._placed(meter.name, meter.place[i]))


class Total(NamedTuple):
    """Sum of meters."""

    time_s: FloatArray
    """Times from 0, (n,) float64, s."""
    power_kw: FloatArray
    """(n,) float64."""
    begin_s: float
    """The file's clock at time 0, s."""
    sampling: Sampling
    notes: dict[str, Any]
    """Meters that begin later than the first or end before the last, with the time, s."""

    def trace(self, name: str, provenance: Provenance) -> PowerTrace:
        """Return the sum as a trace."""
        trace = PowerTrace(self.time_s, self.power_kw, name, provenance)
        trace.__dict__["_sampling"] = self.sampling  # no field, as it identifies no trace
        return trace


def held_total(series: Mapping[str, tuple[FloatArray, FloatArray]]) -> Total:
    """Sum of series of samples that hold until the next.

    If the meters report in rounds, as the GPUs of a node do, a round is one sample at its first time. Otherwise there
    is a sample at each time of any meter. The sum begins when all meters have reported, and ends with the last.

    Parameters
    ----------
    series : time_s and power_kw of each meter by name, (n_i,) float64, times increasing.
    """
    starts_s = {name: float(time_s[0]) for name, (time_s, _) in series.items()}
    ends_s = {name: float(time_s[-1]) for name, (time_s, _) in series.items()}
    rounds = _in_rounds([time_s for time_s, _ in series.values()])
    begin_s = max(time_s[0] for time_s in rounds)
    time_s = np.unique(np.concatenate(rounds))
    time_s = time_s[time_s >= begin_s]
    power_kw = np.zeros_like(time_s)
    for times_s, (_, values_kw) in zip(rounds, series.values(), strict=True):
        power_kw += values_kw[np.searchsorted(times_s, time_s, side="right") - 1]
    several = {name: times_s for name, (times_s, _) in series.items() if len(times_s) > 1}
    sampling = Sampling(0.0, 0.0, 0, 0.0, 0.0)
    if len(time_s) > 1:
        sampling = replace(sampling_of(several or {"": time_s}), meters=len(series))
    apart_s = max(GAP_INTERVALS * sampling.interval_s, 1e-9)
    late = {name: round(time - min(starts_s.values()), 3) for name, time in starts_s.items()}
    early = {name: round(max(ends_s.values()) - time, 3) for name, time in ends_s.items()}
    notes = {"starts_late_s": late, "ends_early_s": early}
    notes = {key: {name: s for name, s in delays.items() if s > apart_s} for key, delays in notes.items()}
    return Total(
        time_s - begin_s, power_kw, float(begin_s), sampling, {key: delays for key, delays in notes.items() if delays}
    )


def _in_rounds(times_s: Sequence[FloatArray]) -> list[FloatArray]:
    """Return the times of meters with those of a round replaced by its first one; unchanged if there are no rounds.

    There are rounds if nearly all times fall into groups that contain each meter once and last a small part of the
    meters' interval.
    """
    n = len(times_s)
    if n == 1 or min(map(len, times_s)) < 2:
        return list(times_s)
    usual_s = min(float(np.median(np.diff(times))) for times in times_s)
    meter = np.repeat(np.arange(n), [len(times) for times in times_s])
    time_s = np.concatenate(times_s)
    order = np.argsort(time_s, kind="stable")
    ordered_s = time_s[order]
    begins = np.flatnonzero(np.diff(ordered_s, prepend=-np.inf) > 0.5 * usual_s)
    counts = np.diff(begins, append=len(ordered_s))
    number = np.repeat(np.arange(len(begins)), counts)
    distinct = np.bincount(np.unique(number * n + meter[order]) // n)
    is_round = (ordered_s[begins + counts - 1] - ordered_s[begins] <= ROUND_SHARE * usual_s) & (distinct == counts)
    begin_s, end_s = max(times[0] for times in times_s), min(times[-1] for times in times_s)
    common = (ordered_s[begins + counts - 1] >= begin_s) & (ordered_s[begins] <= end_s)
    if not common.any() or np.mean((is_round & (counts == n))[common]) < COMPLETE_ROUNDS:
        return list(times_s)
    time_s[order] = np.where(is_round[number], ordered_s[begins][number], ordered_s)
    return np.split(time_s, np.cumsum([len(times) for times in times_s])[:-1])


def one_of(names: Iterable[str], wanted: str | None, where: str, option: str) -> str:
    """Return the name that a file has or that was asked for; raise TraceError if there are several or none."""
    choices = sorted(set(names))
    if wanted is not None:
        if wanted not in choices:
            raise TraceError(f"{where}: has no {wanted!r}; it has {', '.join(choices) or 'none'}: correct {option}")
        return wanted
    if len(choices) != 1:
        raise TraceError(f"{where}: has {', '.join(choices) or 'no power'}; choose one with {option}")
    return choices[0]
