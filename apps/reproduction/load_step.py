"""The step of the paper's Fig. 3 on toy6: the voltage at the data centre when its load comes, and when it goes."""

from __future__ import annotations

from typing import Any

from dcgrid_env import Scenario, Series, make_scenario
from dcgrid_env.apps.reproduction.levers import settled
from dcgrid_env.apps.reproduction.study_runs import INVERTERS, NO_CONTROL, Law, Runs
from dcgrid_env.traces.trace import PowerTrace

STEP_LAWS = {"none": NO_CONTROL, "inverters": INVERTERS, "both": Law(k_p_mw_per_pu=10.0)}
"""k_p = 10 MW/p.u., so that the active axis shows."""
CHANGES = ("comes", "goes")
SITE = 4
STEP_AT = 20
"""First step after the change."""


def step_scenario(change: str) -> Scenario:
    """toy6 with a load that comes at 20 s, as in the preset, or with the same load gone from then on."""
    scenario = make_scenario("toy6", split="test")
    if change == "comes":
        return scenario
    idle = float(scenario.datacenters.parameters.p_idle_kw[0] / scenario.datacenters.parameters.p_rated_kw[0])
    gone = PowerTrace([0.0, STEP_AT, 1000.0], [1.0, idle, idle], "a load that goes", rated_kw=1.0)
    return make_scenario("toy6", trace=(gone,) * 3, workload={"recording_split": "recording"}, split="train")


def step_series(runs: Runs, change: str) -> dict[str, Series]:
    """The first episode under each law."""
    return {name: runs.series(step_scenario(change), law, 0) for name, law in STEP_LAWS.items()}


def step_response(runs: Runs) -> dict[str, Any]:
    """The voltage at the data centre before and after each change, and what it would be with the load as an injection.

    ``runs`` has the mean over 10 s before the change, 10 s after it, and the last 10 s. ``site_pu`` is the voltage with
    the rating of the data centre counted as an injection. ``substation_pu`` is the voltage of the substation.
    """
    records = []
    for change in CHANGES:
        for name, series in step_series(runs, change).items():
            v = series.v_pu[:, series.scenario.feeder.index(SITE)]
            before, after, end = (float(v[a:b].mean()) for a, b in ((10, 20), (21, 31), (-10, None)))
            records.append({"change": change, "law": name, "before_pu": before, "after_pu": after, "end_pu": end})
    scenario = step_scenario("comes")
    v = settled(scenario, {SITE: -float(scenario.datacenters.parameters.p_rated_kw[0])})
    return {
        "runs": records,
        "site_pu": float(v[scenario.feeder.index(SITE)]),
        "substation_pu": scenario.source_voltage_pu,
    }
