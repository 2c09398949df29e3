"""Power smoothing in newer GPUs: a power floor, limited ramps, and a time for which the floor outlasts a job.

    target_k = max(draw_k, floor) while the job runs and for the hysteresis time after, else draw_k
    drawn_k  = target_k within [drawn_{k-1} - down dt, drawn_{k-1} + up dt]

The four settings are those of the power smoothing of NVIDIA's Blackwell GPUs (NVML: a floor in percent, ramp-up and
ramp-down rates in W/s, a hysteresis in ms); arXiv 2508.14318 describes its use in training. The values are choices. A
job that the ramp-up limit holds back runs no longer for it here.
"""

from dataclasses import dataclass, fields

import numpy as np

from dcgrid_env.traces.checks import FloatArray
from dcgrid_env.traces.time_grid import GRID_S, IDLE_SHARE, check_range

_RANGES = {
    "floor_share": (IDLE_SHARE, 0.9),
    "ramp_up_share_per_s": (1e-3, 1e3),
    "ramp_down_share_per_s": (1e-3, 1e3),
    "hysteresis_s": (0.0, 3600.0),
}


@dataclass(frozen=True)
class PowerSmoothing:
    """Settings of the smoothing; shares are of the rating. A field out of its range raises TraceError."""

    floor_share: float = 0.65
    ramp_up_share_per_s: float = 0.5
    ramp_down_share_per_s: float = 0.5
    hysteresis_s: float = 5.0

    def __post_init__(self) -> None:
        for field in fields(self):
            check_range(self, field, _RANGES[field.name])


def smoothed(share: FloatArray, running: np.ndarray, smoothing: PowerSmoothing) -> FloatArray:
    """Apply power smoothing to the draw of synchronous GPUs; the added power is actually drawn.

    Parameters
    ----------
    share : (n,) float64, draw without smoothing on the grid of 0.1 s, share of rating.
    running : (n,) bool, whether a job runs.
    smoothing : settings of the smoothing.

    Returns
    -------
    (n,) float64, share of rating, between the lowest of `share` and the highest of `share` and the floor
    """
    steps = np.arange(len(share))
    last_run = np.maximum.accumulate(np.where(running, steps, -len(share) - 1e9))
    lasting = steps - last_run <= smoothing.hysteresis_s / GRID_S + 1e-9
    target = np.where(lasting, np.maximum(share, smoothing.floor_share), share)
    up, down = smoothing.ramp_up_share_per_s * GRID_S, smoothing.ramp_down_share_per_s * GRID_S
    # One step decides the next, so this is a loop; over plain floats it takes a third of the time.
    drawn, previous = [], float(target[0])
    for want in target.tolist():
        previous = min(max(want, previous - down), previous + up)
        drawn.append(previous)
    return np.array(drawn)
