"""Active against reactive power on feeders of low and high r/x, and the claim on it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from dcgrid_env import Feeder, Scenario, load_feeder, make_scenario, sensitivity
from dcgrid_env.apps.reproduction.levers import settled
from dcgrid_env.apps.reproduction.study_runs import BOTH, NO_CONTROL, REACTIVE, Law, Runs
from dcgrid_env.apps.reproduction.verdict import DOES_NOT, HOLDS, PARTLY, Records, Row, decide, row

R_TIMES = 3.0
"""Factor on r/x in the variant of ieee123."""


def turned(feeder: Feeder, times: float) -> Feeder:
    """The feeder with r/x of every branch multiplied and the magnitude of its impedance kept."""
    r, x = feeder.r_ohm, feeder.x_ohm
    scale = np.divide(np.hypot(r, x), np.hypot(times * r, x), out=np.ones_like(r), where=r + x > 0)
    return dataclasses.replace(feeder, r_ohm=times * r * scale, x_ohm=x * scale)


def axes(runs: Runs) -> list[dict[str, Any]]:
    """Active against reactive power, on feeders of low and high r/x: at the sites, and in closed loop."""
    plain = runs.setting.published(5)
    steep = turned(load_feeder("ieee123"), R_TIMES)
    cases = {
        "ieee123": plain,
        f"ieee123, r/x times {R_TIMES:g} at the same impedance": make_scenario(plain, feeder=steep),
        "ieee33-weak": make_scenario("ieee33-weak", **runs.setting.load.fields),
    }
    records = []
    for name, scenario in cases.items():
        by_axis = {key: runs.run(scenario, law) for key, law in _AXES.items()}
        records.append(
            {"feeder": name}
            | _own_slopes(scenario)
            | {f"{key}_deviation_pu": run.deviation_pu for key, run in by_axis.items()}
            | {f"{key}_J": run.mean("J") for key, run in by_axis.items()}
            | {"active_delay_s": by_axis["active"].mean("delay_mean_s")}
            | {"converged_pct": 100.0 * by_axis["none"].mean("power_flow_converged")}
        )
    return records


_AXES = {
    "none": NO_CONTROL,
    "active": Law(k_p_mw_per_pu=10.0, k_q_mvar_per_pu_s=0.0),
    "reactive": REACTIVE,
    "both": BOTH._replace(k_p_mw_per_pu=10.0),
}


def _own_slopes(scenario: Scenario) -> dict[str, float]:
    """Means over the sites, all at their rating: r/x of the way to the substation, and the rise for 0.1 MW or Mvar."""
    feeder, buses = scenario.feeder, scenario.datacenters.buses
    assert buses is not None
    r, x = sensitivity(feeder)
    places = [feeder.index(bus) for bus in buses]
    full = dict(zip(buses, scenario.datacenters.parameters.p_rated_kw.tolist(), strict=True))
    before = settled(scenario, full)
    sites = list(zip(buses, places, strict=True))
    shed = [10.0 * (settled(scenario, full | {b: full[b] - 100.0}) - before)[i] for b, i in sites]
    given = [10.0 * (settled(scenario, full, {b: 100.0}) - before)[i] for b, i in sites]
    return {
        "r_over_x": float(np.mean(r[places, places] / x[places, places])),
        "rise_pu_per_mw": float(np.mean(shed)),
        "rise_pu_per_mvar": float(np.mean(given)),
    }


def active(records: Records) -> Row:
    """Active against reactive power."""
    plain, steep = (next(r for r in records["axes"] if r["feeder"] == name) for name in ("ieee123", "ieee33-weak"))
    ratio = [r["rise_pu_per_mw"] / r["rise_pu_per_mvar"] for r in (plain, steep)]
    gain = [r["none_J"] - r["active_J"] for r in (plain, steep)]
    stronger = ratio[1] > 1.0 > ratio[0]
    verdict = decide(stronger and steep["active_J"] < steep["reactive_J"], stronger or gain[1] > gain[0])
    per_unit = (
        "it is, per unit of power; over two minutes the clock only shifts work in time, while reactive power persists"
    )
    return row(
        "active power is the stronger lever where r/x is high",
        "stronger where r/x is high",
        f"per MW against per Mvar at the site: {ratio[0]:.2f} at r/x {plain['r_over_x']:.2f} (ieee123), {ratio[1]:.2f} "
        f"at {steep['r_over_x']:.2f} (ieee33-weak); the active axis alone changes J by {-gain[0]:+.2f} and "
        f"{-gain[1]:+.2f}, the reactive alone by {plain['reactive_J'] - plain['none_J']:+.2f} and "
        f"{steep['reactive_J'] - steep['none_J']:+.2f}",
        verdict,
        {
            HOLDS: "per unit of power, and in what the axis alone does for J",
            PARTLY: per_unit if stronger else "not per unit of power; it only does more for J than where r/x is low",
            DOES_NOT: "neither per unit of power, nor in what the axis alone does for J",
        }[verdict],
    )
