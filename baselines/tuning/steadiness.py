"""Whether a droop's closed loop is stable, and its gains drawn back to where it is.

The zero of the score must not be a law that oscillates. Two conditions are checked on the validation split:

- The spectral radius of the linearised closed loop (``laws.stability``) is at most 1 in every placement.
- The loop has no limit cycle: with constant inputs, the clocks and reactive set points settle.

The second condition covers what the linear model leaves out: limits, the steeper voltage of the exact power flow, noise
that excites a slowly decaying mode. The inputs are constant because alternating demand moves every law to and fro.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.laws.stability import ClosedLoops, is_stable
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.traces import PowerTrace

DEMAND_SHARES = (0.3, 0.5, 0.7, 0.85, 1.0)
"""Demand of a site in an episode with held inputs, share of its rating; each site draws one."""
STEPS = 100
"""Steps of such an episode; in the second half the settings must not change."""
SWING = 0.05
"""Swing of a setting that counts, as a share of its range."""
TURNS = 4.0
"""Path of a setting over its swing from which it goes to and fro: two periods."""


def has_limit_cycle(scenario: Scenario, droop: Droop, episodes: int) -> bool:
    """Whether a setting still swings to and fro in an episode whose inputs are held constant.

    Parameters
    ----------
    scenario
        Gives the feeder, the devices and the split.
    droop
        The law.
    episodes
        Episodes that are checked: seeds 0, 1, ..; each site draws its demand from ``DEMAND_SHARES``.
    """
    constant = with_constant_inputs(scenario)
    recorder = rollout(constant, droop, range(episodes))
    reactive = np.where(constant.q_scale_kvar > 0.0, 2.0 * constant.q_scale_kvar, np.inf)
    for series in map(recorder.series, range(episodes)):
        settings = [series.q_kvar[:, : len(reactive)] / reactive]
        if constant.datacenters.count:
            settings.append(
                series.f_mhz / (constant.datacenters.parameters.f_max_mhz - constant.datacenters.parameters.f_min_mhz)
            )
        late = np.concatenate(settings, axis=1)[STEPS // 2 :]
        swing, path = np.ptp(late, axis=0), np.abs(np.diff(late, axis=0)).sum(axis=0)
        if ((swing > SWING) & (path > TURNS * swing)).any():
            return True
    return False


def with_constant_inputs(scenario: Scenario) -> Scenario:
    """A scenario whose demand and loads are constant, without noise, sunshine, faults and sags."""
    n = 8 * STEPS  # each split has a fifth at least
    time_s = scenario.dt_s * np.arange(n)
    demand = tuple(PowerTrace(time_s, np.full(n, share), f"held at {share:g}", rated_kw=1.0) for share in DEMAND_SHARES)
    constant = {
        "trace": demand,
        "workload.window": "start",
        "workload.site_correlation": 0.0,
        "background.load_sigma": 0.0,
    }
    silent = {"sensing.noise_pu": 0.0, "faults": (), "sags": (), "inverters.injection": None}
    return scenario.replace(**constant, **silent, horizon=STEPS)


def drawn_back(loops: ClosedLoops, parameters: dict[str, Any]) -> dict[str, Any]:
    """A droop's gains times the largest factor up to 1 with which its closed loop is stable."""

    def scaled(factor: float) -> dict[str, Any]:
        return {name: float(f"{factor * gain:.4g}") for name, gain in parameters.items()}

    def stable(factor: float) -> bool:
        return is_stable(loops.largest_radius(Droop(**scaled(factor))))

    if stable(1.0):
        return scaled(1.0)
    low, high = 0.0, 1.0
    while high - low > 1e-3 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return scaled(low)
