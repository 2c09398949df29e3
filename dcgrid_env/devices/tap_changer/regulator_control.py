"""Settings of the regulators' built-in controls that a scenario chooses: timers, and offsets of the set points.

    reset: the timer runs while the relay is out of band and returns to zero in band
    integrating: the timer runs while the relay is out of band and counts down in band

``reset`` is the convention of OpenDSS's RegControl and of the sequential mode of the Eaton CL-7 control, whose
time-integrating mode is ``integrating`` (manual MN225003EN). A control acts when its delay ends, on the volts measured
at that moment, so step lengths do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np

from dcgrid_env.core.checked import choice, finite, number, pairs, refuse, settle
from dcgrid_env.devices.set_points import SHORTEST_HOLD_S
from dcgrid_env.grid.three_phase_tables import RegulatorTable

Timer = Literal["reset", "integrating"]
Schedule = tuple[tuple[float, float], ...]
"""Pairs of an hour of the day and an offset, V, that applies from then on until the hour of the next pair."""
FARTHEST_OFFSET_V = 12.0
"""Largest offset of a set point in either direction, V: a tenth of the 120 V base."""
_ROUNDING_H = 1e-9


@dataclass(frozen=True, kw_only=True)
class RegulatorControl:
    """Timers and set points of the regulators that their built-in controls move."""

    timer: Timer = choice("reset", "integrating", default="integrating")
    """Time delay: ``"reset"`` returns to zero when the relay is back in band, ``"integrating"`` counts down in
    band."""
    offset_v: float | tuple[tuple[str, float | Schedule], ...] = pairs(default=0.0)
    """Addition to the set point ``vreg_v`` of the table, V on the relay's base: one number for all, or a mapping from
    banks or single regulators to numbers or daily schedules. The name of a regulator goes before that of its bank;
    others have none. A schedule is a list of (hour, volts), constant between its hours and over midnight."""
    hold_s: float = number(SHORTEST_HOLD_S, 86_400.0, default=60.0)
    """Least time between changes of a set point by an agent (mode ``"setpoint"``), s."""

    def __post_init__(self) -> None:
        settle(self)
        value = self.offset_v
        named = value if isinstance(value, tuple) else (("all", value),)
        if not all(map(_is_pair, named)) or len({name for name, _ in named}) < len(named):
            volts = f"volts between -{FARTHEST_OFFSET_V:g} and {FARTHEST_OFFSET_V:g}"
            schedules = "to lists of (hour, volts) with rising hours from 0 to less than 24"
            raise refuse(
                self, "offset_v", f"give {volts}, or a mapping from banks or regulators to these or {schedules}"
            )

    @cached_property
    def has_schedules(self) -> bool:
        """Whether any offset follows a schedule."""
        return isinstance(self.offset_v, tuple) and any(isinstance(value, tuple) for _, value in self.offset_v)

    def offsets_v(self, table: RegulatorTable) -> np.ndarray:
        """Return the constant offset of each regulator of a table, V; 0 for one with a schedule."""
        return np.array([0.0 if isinstance(value, tuple) else value for value in self._by_row(table)], np.float64)

    def scheduled_v(self, table: RegulatorTable, hour: np.ndarray) -> np.ndarray:
        """Return the offsets by schedules at hours (row,), V, (row, n_regulator); 0 for one without a schedule."""
        offset_v = np.zeros((len(hour), len(table)))
        for column, schedule in enumerate(self._by_row(table)):
            if isinstance(schedule, tuple):
                hours, volts = np.array(schedule).T
                # -1 is the last one of yesterday.
                last = np.searchsorted(hours, (hour + _ROUNDING_H) % 24.0, side="right") - 1
                offset_v[:, column] = volts[last]
        return offset_v

    def _by_row(self, table: RegulatorTable) -> list[float | Schedule]:
        """The offset or schedule of each regulator of a table."""
        if not isinstance(self.offset_v, tuple):
            return [self.offset_v] * len(table)
        named = dict(self.offset_v)
        return [named.get(name, named.get(bank, 0.0)) for name, bank in zip(table.name, table.bank, strict=True)]


def _is_pair(pair: object) -> bool:
    """Whether a value is a name with its offset or schedule."""
    return isinstance(pair, tuple) and len(pair) == 2 and isinstance(pair[0], str) and _is_allowed(pair[1])


def _is_allowed(value: object) -> bool:
    """Whether a value is an offset or a schedule of offsets."""
    if not isinstance(value, tuple):
        return _is_offset(value)
    if not value or not all(isinstance(entry, tuple) and len(entry) == 2 and _is_offset(entry[1]) for entry in value):
        return False
    hours = [entry[0] for entry in value]
    in_day = all(not isinstance(hour, bool) and finite(hour, 0.0, 24.0) and hour < 24.0 for hour in hours)
    return in_day and all(earlier < later for earlier, later in pairwise(hours))


def _is_offset(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return -FARTHEST_OFFSET_V <= value <= FARTHEST_OFFSET_V
