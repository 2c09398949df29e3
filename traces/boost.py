"""Short draws above the rating: work that begins at once overshoots until the power controller's average catches up.

    drawn = power + min(power - mean, (boost - 1) compute)    where power > mean, else power
    mean' = (1 - a) mean + a power                            a = dt / averaging time

with the part of the power that does compute-bound work. A level that lasts is drawn as it is, and nothing exceeds
the boost. Peaks of 1.0 to 1.3 of the rated power are reported for A100 servers; that an overshoot fades within the
averaging time is how such power controllers are built, not a measurement.
"""

import numpy as np

from dcgrid_env.traces.grid import GRID_S, IDLE_SHARE, rounded
from dcgrid_env.traces.trace import FloatArray, PowerTrace

AVERAGING_S = 1.0
"""Time within which an overshoot fades, s."""


def boosted(share: FloatArray, compute: FloatArray, boost_share: float) -> tuple[FloatArray, FloatArray]:
    """Power (n,) and its compute-bound part (n,) on the grid of 0.1 s, shares of rating, with short draws above 1."""
    from scipy.signal import lfilter

    weight = GRID_S / AVERAGING_S
    # The mean before each step, from idle on.
    before = np.concatenate(([IDLE_SHARE], share[:-1]))
    mean, _ = lfilter([weight], [1.0, weight - 1.0], before, zi=[(1.0 - weight) * IDLE_SHARE])
    extra = rounded(np.clip(share - mean, 0.0, (boost_share - 1.0) * compute))
    return share + extra, compute + extra


def boosted_trace(trace: PowerTrace, boost_share: float) -> PowerTrace:
    """A generated trace, whose compute-bound part is known, with short draws above its rating of 1 kW."""
    compute = trace.resample_compute(GRID_S)
    assert compute is not None
    # A trace may hold a level for longer than a step of the grid.
    drawn, compute = boosted(trace.resample(GRID_S), compute, boost_share)
    time_s = np.arange(len(drawn) + 1) * GRID_S
    return PowerTrace(
        time_s, np.append(drawn, drawn[-1]), trace.name, trace.provenance, np.append(compute, compute[-1]),
        trace.requests,
    )  # fmt: skip
