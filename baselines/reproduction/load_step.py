"""The step of the paper's Fig. 3 on toy6: what the voltage at the data centre does when its load is added."""

from __future__ import annotations

from typing import Any

from dcgrid_env import Series, make_scenario
from dcgrid_env.baselines.reproduction.study_runs import INVERTERS, NONE, Law, Runs

STEP_LAWS = {"none": NONE, "inverters": INVERTERS, "both": Law(k_p_mw_per_pu=10.0)}
"""k_p = 10 MW/p.u., so that the active axis shows."""
SITE = 4
STEP_AT = 20
"""First step with the load."""


def step_series(runs: Runs) -> dict[str, Series]:
    """The first test episode under each law."""
    scenario = make_scenario("toy6", split="test")
    return {name: runs.series(scenario, law, 0) for name, law in STEP_LAWS.items()}


def step_response(runs: Runs) -> list[dict[str, Any]]:
    """Voltage at the data centre: mean over 10 s before the load, 10 s with it, and the last 10 s."""
    records = []
    for name, series in step_series(runs).items():
        v = series.v_pu[:, series.scenario.feeder.index(SITE)]
        before, after, end = (float(v[a:b].mean()) for a, b in ((10, 20), (21, 31), (-10, None)))
        records.append({"law": name, "before_pu": before, "after_pu": after, "end_pu": end})
    return records
