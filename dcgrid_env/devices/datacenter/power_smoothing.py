"""Settings of GPU power smoothing, in the terms of NVML's profiles for Blackwell GPUs.

A profile has a floor in percent of the largest power, ramp rates up and down in W/s per GPU and a hysteresis in ms
(NVML API reference, "Power Smoothing Information"). GB200 allows floors from 20 to 90 %. No source gives typical rates
or times, so the defaults are choices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dcgrid_env.core.checked import choice, finite, number, refuse, settle
from dcgrid_env.devices.ratings import Rating, check_each, per_device

GPU_RATED_W = 1200.0
"""Rated power of a GPU of the GB200, W."""
LARGEST_RAMP_W_PER_S = 1e9
LONGEST_S = 86_400.0


@dataclass(frozen=True, kw_only=True)
class PowerSmoothing:
    """Power smoothing: a floor of a site's draw, ramp limits, and the time for which the floor outlasts the work.

    Power drawn in excess of the work is burnt, and charged. Work that a slow upward ramp does not serve waits in the
    queue.
    """

    floor_share: float = number(0.0, 1.0, default=0.9)
    """Floor as a share of the rated power (GB200: 0.2 to 0.9), above the idle share, or 0 for none. If the agent
    decides, the highest value that it may choose."""
    ramp_up_w_per_s: float = number(1e-9, LARGEST_RAMP_W_PER_S, default=1200.0)
    """Fastest rise of the draw, W/s per GPU. If the agent decides, the fastest that it may choose."""
    ramp_down_w_per_s: float = number(1e-9, LARGEST_RAMP_W_PER_S, default=1200.0)
    """Fastest fall of the draw, W/s per GPU. If the agent decides, the fastest that it may choose."""
    hysteresis_s: float = number(0.0, LONGEST_S, default=5.0)
    """Time that the work must draw less than the floor before the floor is released, s, rounded to whole steps."""
    gpus: Rating | None = None
    """Number of GPUs of a site, one number or one for each; None: its rating over ``gpu_rated_w``."""
    gpu_rated_w: float | None = None
    """Rated power of a GPU, W, if ``gpus`` is not given; None: 1200 W, that of a GPU of the GB200."""
    control: Literal["fixed", "agent"] = choice("fixed", "agent", default="fixed")
    """Whether floor and ramps are fixed at these values, or channels of the site's agent: ``floor``, ``ramp_up`` and
    ``ramp_down``. Inactive channels mean no floor and the fastest ramps."""
    change_every_s: float = number(0.0, LONGEST_S, default=10.0)
    """Time that the agent's choice is kept before it may change again, s, rounded to whole steps."""
    slowest_share: float = number(1e-6, 1.0, default=0.01)
    """Slowest ramp that the agent may choose, as a share of the fastest."""
    burnt_weight: float = number(0.0, 1e9, default=1.0)
    """Weight of the cost term ``burnt``: power burnt over the sum of the ratings. At 1, all sites burning
    their ratings cost as much as a mean deviation of 0.01 p.u."""

    def __post_init__(self) -> None:
        settle(self)
        if self.gpu_rated_w is not None and not finite(self.gpu_rated_w, 1.0, 1e6):
            raise refuse(self, "gpu_rated_w", "give a number in [1, 1e+06], or None")
        if self.gpus is not None and self.gpu_rated_w is not None:
            raise refuse(self, "gpus", "give either gpus or gpu_rated_w, since one follows from the other")

    def check_sites(self, n: int, idle_share: float) -> None:
        """Raise FieldError if the settings do not fit that many sites with this idle share."""
        if 0.0 < self.floor_share <= idle_share:
            raise refuse(
                self, "floor_share", f"give more than the idle_share of the sites, {idle_share:g}, or 0 for none"
            )
        if self.gpus is not None:
            check_each(self, "gpus", n, 1.0, 1e9)

    def gpus_of(self, p_rated_kw: np.ndarray) -> np.ndarray:
        """Return the number of GPUs of sites with these ratings, (slot,)."""
        if self.gpus is not None:
            return per_device(self.gpus, len(p_rated_kw))
        return 1000.0 * p_rated_kw / (self.gpu_rated_w or GPU_RATED_W)

    def ramps_kw_per_s(self, p_rated_kw: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the fastest rise and fall of sites with these ratings, kW/s, (slot,) each."""
        of_gpus = self.gpus_of(p_rated_kw) / 1000.0
        return self.ramp_up_w_per_s * of_gpus, self.ramp_down_w_per_s * of_gpus
