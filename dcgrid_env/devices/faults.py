"""Faults of an episode: a device is lost at a time drawn in each episode, and may return.

A lost inverter injects nothing. A data centre that trips continues its work on a separate supply and draws nothing from
the grid until it reconnects. Some 1,500 MW of data centres did so in July 2024 [1]_. A lost capacitor injects nothing.
A lost storage neither charges nor discharges, and keeps its energy except for standby losses.

References
----------
.. [1] NERC, "Incident review: considering simultaneous voltage-sensitive load reductions", 2025.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from dcgrid_env.devices.registry import DEVICE_REGISTRY

CAPACITOR = "capacitor"
"""Kind of equipment that a fault may affect, in addition to the kinds of devices."""


@dataclass(frozen=True)
class Fault:
    """One device is lost for a while."""

    among: tuple[str, ...]
    """Candidates: one is drawn evenly among these kinds (of devices, or capacitor) or agent ids (dc_0, inv_2)."""
    begin_s: tuple[float, float]
    """Earliest and latest beginning, s from the episode's; a fault after its end does not happen."""
    duration_s: tuple[float, float] = (math.inf, math.inf)
    """Shortest and longest duration, s; infinite lasts until the episode's end."""

    def __post_init__(self) -> None:
        if isinstance(self.among, str) or not self.among:
            kinds = ", ".join((*DEVICE_REGISTRY, CAPACITOR))
            raise ValueError(f"fault: among is {self.among!r}; give a tuple of {kinds} or agent ids")
        object.__setattr__(self, "among", tuple(self.among))
        for name in ("begin_s", "duration_s"):
            value = getattr(self, name)
            if not isinstance(value, tuple | list) or len(value) != 2 or not all(map(_is_number, value)):
                raise ValueError(f"fault: {name} is {value!r}; give a pair of numbers, a shortest and a longest in s")
            low, high = value
            object.__setattr__(self, name, (low, high))
            if not 0.0 <= low <= high or (name == "begin_s" and math.isinf(high)):
                raise ValueError(f"fault: {name} is {(low, high)!r}; give a shortest and a longest of at least 0 s")
        if math.isinf(self.duration_s[1]) and not math.isinf(self.duration_s[0]):
            raise ValueError(f"fault: duration_s is {self.duration_s!r}; give two finite times, or two infinite ones")


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
