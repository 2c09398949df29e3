"""Settings of the regulators' built-in controls that a scenario chooses: timers, and offsets of the set points.

    reset: the timer runs while the relay is out of band and returns to zero in band
    integrating: the timer runs while the relay is out of band and counts down in band
    per_step: one decision per step, from the relay volts of the step before and those predicted within the step

``reset`` is the convention of OpenDSS's RegControl and of the sequential mode of the Eaton CL-7 control, whose
time-integrating mode is ``integrating`` (manual MN225003EN). With either, a control acts when its delay ends, on the
volts measured at that moment, and step lengths do not matter. ``per_step`` is the rule of the environments ``-v0``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from dcgrid_env.core.checked import check_fields, choice, number, refuse, settle
from dcgrid_env.devices.set_points import SHORTEST_HOLD_S

Timer = Literal["per_step", "reset", "integrating"]
FARTHEST_OFFSET_V = 12.0
"""Largest offset of a set point in either direction, V: a tenth of the 120 V base."""


@dataclass(frozen=True, kw_only=True)
class RegulatorControl:
    """Timers and set points of the regulators that their built-in controls move."""

    timer: Timer = choice("per_step", "reset", "integrating", default="per_step")
    """Time delay: ``"reset"`` returns to zero when the relay is back in band, ``"integrating"`` counts down in band;
    ``"per_step"`` decides once per step."""
    offset_v: float | tuple[tuple[str, float], ...] = 0.0
    """Addition to the set point ``vreg_v`` of the table, V on the relay's base; one number for all banks, or a mapping
    from banks to numbers. Banks that a mapping does not name have none."""
    hold_s: float = number(SHORTEST_HOLD_S, 86_400.0, default=60.0)
    """Least time between changes of a set point by an agent (mode ``"setpoint"``), s."""

    def __post_init__(self) -> None:
        settle(self, offset_v=_pairs)
        check_fields(self)
        value = self.offset_v
        pairs = value if isinstance(value, tuple) else ((None, value),)
        if not all(isinstance(pair, tuple) and len(pair) == 2 and _is_offset(pair[1]) for pair in pairs):
            volts = f"volts between -{FARTHEST_OFFSET_V:g} and {FARTHEST_OFFSET_V:g}"
            raise refuse(self, "offset_v", f"give {volts}, or a mapping from banks to these")

    def offsets_v(self, banks: tuple[str, ...]) -> tuple[float, ...]:
        """Return the offset of each of these banks, V."""
        if not isinstance(self.offset_v, tuple):
            return (float(self.offset_v),) * len(banks)
        named = dict(self.offset_v)
        return tuple(float(named.get(bank, 0.0)) for bank in banks)


def _is_offset(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return -FARTHEST_OFFSET_V <= value <= FARTHEST_OFFSET_V


def _pairs(value: object) -> Any:
    """Return pairs of a bank and an offset from a mapping or from JSON lists; any other value unchanged."""
    if isinstance(value, Mapping):
        return tuple(value.items())
    if isinstance(value, list | tuple):
        return tuple(tuple(pair) if isinstance(pair, list) else pair for pair in value)
    return value
