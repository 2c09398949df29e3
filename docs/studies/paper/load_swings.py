"""Analyse the load itself: its ramps, four models next to one another, and dips under a feeder's own regulators."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env import make_scenario
from dcgrid_env.apps.reproduction.study_runs import Runs
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.traces import TRACE_SOURCES
from dcgrid_env.traces.trace import PowerTrace

MODELS = ("llama3-70b", "llama3-405b", "mixtral-8x22b", "deepseek-v3")
LARGE = 0.05
"""A ramp beyond this share of the peak is counted."""
BINS = (LARGE, 0.1, 0.2, 0.3, np.inf)
BIN_NAMES = ("5 to 10 %", "10 to 20 %", "20 to 30 %", "over 30 %")
INTERVALS_S = (None, 1.0)
"""Ramps from sample to sample, and between means over a second."""
DIPS_S = (0.5, 1.0, 5.0, 10.0, 20.0, 29.0, 31.0, 60.0)
DIP_FEEDER = "ieee123-3ph-published"
DIP_SITES = (13, 28, 53, 77, 99)
DIP_AT_S, DIP_END_S, DIP_STEP_S = 30.0, 120.0, 0.5
IDLE_SHARE = 0.2


def ramps(runs: Runs) -> list[dict[str, Any]]:
    """Compute the distribution of the ramps of the study's load beyond 5 % of its peak."""
    trace = runs.setting.load.trace()
    records = []
    for interval_s in INTERVALS_S:
        power = trace.power_kw if interval_s is None else trace.resample(interval_s)
        ramp = np.abs(np.diff(power)) / trace.power_kw.max()
        counts = np.histogram(ramp, BINS)[0]
        records.append(
            {
                "interval_s": float(np.median(np.diff(trace.time_s))) if interval_s is None else interval_s,
                "ramps": len(ramp),
                "large": int(counts.sum()),
                "shares_pct": {
                    name: 100.0 * float(n) / max(int(counts.sum()), 1)
                    for name, n in zip(BIN_NAMES, counts, strict=True)
                },
            }
        )
    return records


def models(runs: Runs) -> list[dict[str, Any]]:
    """Standard deviation and 99 % quantile of the 1 s ramps of four generated models, % of the rating."""
    records = []
    for name in MODELS:
        seconds = [TRACE_SOURCES[name].generate(600.0, seed).resample(1.0) for seed in range(4)]
        records.append(
            {
                "model": name,
                "std_pct": 100.0 * float(np.mean([s.std() for s in seconds])),
                "ramp_pct": 100.0 * float(np.mean([np.quantile(np.abs(np.diff(s)), 0.99) for s in seconds])),
            }
        )
    return records


def dips(runs: Runs) -> list[dict[str, float]]:
    """Taps that the regulators of the feeder with its phases make when five sites idle together for a while.

    Without control and without noise; a run without a dip makes none.
    """
    records = []
    for dip_s in (0.0, *DIPS_S):
        times, shares = [0.0, DIP_AT_S, DIP_AT_S + dip_s, 2.0 * DIP_END_S], [1.0, IDLE_SHARE, 1.0, 1.0]
        if not dip_s:
            times, shares = [0.0, 2.0 * DIP_END_S], [1.0, 1.0]
        load = PowerTrace(times, shares, f"dip of {dip_s:g} s", rated_kw=1.0)
        scenario = make_scenario(
            DIP_FEEDER,
            datacenters={"buses": DIP_SITES},
            trace=(load,) * 3,
            workload={"recording_split": "recording", "window": "start"},
            split="train",
            background={"load_sigma": 0.0},
            dt_s=DIP_STEP_S,
            horizon=round(DIP_END_S / DIP_STEP_S),
        )
        run = rollout(scenario, NoControl(), [0]).series(0)
        first = round(DIP_AT_S / DIP_STEP_S)
        nodes = [node for bus in DIP_SITES for node in scenario.feeder.nodes_at(scenario.feeder.index(bus))]
        change = np.abs(run.v_pu[first + 1, nodes] - run.v_pu[first, nodes])
        records.append({"dip_s": dip_s, "taps": run.metrics()["tap_moves"], "largest_change_pu": float(change.max())})
    return records
