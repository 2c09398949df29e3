"""Short draws above what a GPU may draw for long: work that begins boosts, until a reserve is spent.

    wanted  = (boost - 1) compute / (1 - idle)      a site with compute-bound work only draws the full boost
    extra   = min(wanted, reserve / dt)             drawn on top of the power, as work that follows the clock
    reserve falls by extra dt, and rises by (boost - 1) dt / 50, up to (boost - 1) x 1 s, while the site rests

A site rests while less than a tenth of the full boost is wanted.
Peaks of 1.0 to 1.3 of the rated power are reported for A100 servers, but not their duration. One second of the full
boost, and 50 s to recover it, are choices.
"""

from dataclasses import replace

import numpy as np

from dcgrid_env.traces.checks import FloatArray
from dcgrid_env.traces.time_grid import GRID_S, IDLE_SHARE
from dcgrid_env.traces.trace import PowerTrace

RESERVE_S = 1.0
"""How long the full boost lasts, s."""
GATHER_S = 50.0
"""How long it takes to gather the reserve again, s."""
REST_SHARE = 0.1
"""Share of the full boost below which a site rests."""


def boosted(share: FloatArray, compute: FloatArray, boost_share: float) -> tuple[FloatArray, FloatArray]:
    """Add short draws above 1 to the power (n,) and its compute-bound part (n,), shares of rating on a 0.1 s grid."""
    beyond = boost_share - 1.0
    most, gathered = beyond * RESERVE_S, beyond * RESERVE_S / GATHER_S * GRID_S
    extra, reserve, resting = np.zeros_like(share), most, REST_SHARE * beyond
    wanted = beyond * compute / (1.0 - IDLE_SHARE)
    for i, want in enumerate(wanted.tolist()):
        drawn = min(want, reserve / GRID_S)
        extra[i] = drawn
        reserve = max(reserve - drawn * GRID_S, 0.0)
        if want < resting:
            reserve = min(reserve + gathered, most)
    extra = np.floor(extra * 2.0**20) * 2.0**-20  # not rounded up, which might exceed the boost
    return share + extra, compute + extra


def boosted_trace(trace: PowerTrace, boost_share: float) -> PowerTrace:
    """Add short draws above the rating to a trace in shares of its rating, whose compute-bound part is known."""
    compute = trace.resample_compute(GRID_S)
    assert compute is not None
    # A trace may hold a level for longer than a step of the grid.
    drawn, compute = boosted(trace.resample(GRID_S), compute, boost_share)
    provenance = trace.provenance
    return PowerTrace(
        trace.time_s[0] + np.arange(len(drawn) + 1) * GRID_S,
        np.append(drawn, drawn[-1]),
        trace.name,
        replace(provenance, parameters={**provenance.parameters, "boost_share": boost_share}),
        np.append(compute, compute[-1]),
        trace.requests,
        trace.rated_kw,
    )
