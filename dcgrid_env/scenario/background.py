"""Background of the devices on the feeder: other loads with their noise, capacitors, and the time of day."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dcgrid_env.core.checked import choice, finite, number, refuse, settle


@dataclass(frozen=True, kw_only=True)
class Background:
    """Loads and capacitors of the feeder in addition to the devices, and the time of day."""

    capacitors: bool = choice(True, False, default=True)
    """Whether the feeder's capacitors are connected."""
    load_sigma: float = number(0.0, 0.3, default=0.05)
    """Standard deviation of the other loads' noise as a share of the load."""
    load_rho: float = number(0.0, 0.999999, default=0.9)
    """Correlation of that noise over one second."""
    start_hour: float | Literal["random"] | None = None
    """Time of day at which an episode begins, h in [0, 24), or "random": drawn in each episode. Base load, generated PV
    and generated requests then follow the time of day (``traces.day_course``). None: "random" for an episode longer
    than an hour; a shorter one stays at the feeder's nominal load and at noon."""

    def __post_init__(self) -> None:
        settle(self)
        hour = self.start_hour
        if hour not in (None, "random") and not (finite(hour, 0.0, 24.0) and hour != 24):
            raise refuse(self, "start_hour", "give an hour from 0 to less than 24, 'random', or None")
