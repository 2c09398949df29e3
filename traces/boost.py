"""Short draws above the rating: a GPU that comes from idle may exceed its rated power until its average catches up.

    wanted = power + (boost - 1) compute        compute: the part of the power that does compute-bound work
    drawn  = min(wanted, (1 - (1 - a) mean) / a)        a = dt / averaging time
    mean'  = (1 - a) mean + a drawn             the power controller holds this moving average at the rating

Peaks of 1.0 to 1.3 of the rated power are reported for A100 servers; that they last as long as the average of a second
allows is how such power controllers are built, not a measurement.
"""

import numpy as np

from dcgrid_env.traces.grid import GRID_S, IDLE_SHARE, rounded
from dcgrid_env.traces.trace import FloatArray, PowerTrace

AVERAGING_S = 1.0
"""Time over which the draw is held to the rating, s."""


def boosted(share: FloatArray, compute: FloatArray, boost_share: float) -> tuple[FloatArray, FloatArray]:
    """Power (n,) and its compute-bound part (n,) on the grid of 0.1 s, shares of rating, with short draws above 1."""
    wanted = share + (boost_share - 1.0) * compute
    weight = GRID_S / AVERAGING_S
    drawn, mean = np.empty_like(share), IDLE_SHARE
    for i, want in enumerate(wanted):
        drawn[i] = min(want, max((1.0 - (1.0 - weight) * mean) / weight, share[i]))
        mean += weight * (drawn[i] - mean)
    drawn = rounded(drawn)
    return drawn, compute + np.maximum(drawn - share, 0.0)


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
