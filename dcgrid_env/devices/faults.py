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

from dcgrid_env.core.checked import refuse, settle, span
from dcgrid_env.devices.registry import DEVICE_REGISTRY

CAPACITOR = "capacitor"
"""Kind of equipment that a fault may affect, in addition to the kinds of devices."""


@dataclass(frozen=True)
class Fault:
    """One device is lost for a while."""

    among: tuple[str, ...]
    """Candidates: one is drawn evenly among these kinds (of devices, or capacitor) or agent ids (dc_0, inv_2)."""
    begin_s: tuple[float, float] = span(0.0, 1e300)
    """Earliest and latest beginning, s from the episode's; a fault after its end does not happen."""
    duration_s: tuple[float, float] = span(0.0, math.inf, default=(math.inf, math.inf))
    """Shortest and longest duration, s; infinite, or None, lasts until the episode's end."""

    def __post_init__(self) -> None:
        settle(self, duration_s=lambda value: (math.inf, math.inf) if value is None else value)
        if not isinstance(self.among, tuple) or not self.among:
            kinds = ", ".join((*DEVICE_REGISTRY, CAPACITOR))
            raise refuse(self, "among", f"give a tuple of {kinds} or agent ids")
        if math.isinf(self.duration_s[1]) and not math.isinf(self.duration_s[0]):
            raise refuse(self, "duration_s", "give two finite times, or two infinite ones")
