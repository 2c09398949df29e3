"""Which lever moves which voltage: near and far inverters, and how often the law acts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dcgrid_env import Feeder, Scenario, make_scenario, sensitivity, solver_for
from dcgrid_env.apps.reproduction.study_runs import INVERTERS, NO_CONTROL, Law, Runs, nodes_of
from dcgrid_env.apps.reproduction.table1 import unserved_pct

STEP_S = 0.1
INTERVALS_S = (0.1, 1.0, 5.0)


def settled(
    scenario: Scenario, p_kw: Mapping[Any, float] | None = None, q_kvar: Mapping[Any, float] | None = None
) -> np.ndarray:
    """Voltages with the base load, p.u., (n_node,), with more active load and reactive injection at some buses.

    A bus shares what it draws among its phases. Regulators stay at the feeder's own taps; NaN without a solution.
    """
    feeder = scenario.feeder
    p, q = feeder.p_load_kw.copy(), feeder.q_load_kvar.copy()
    if isinstance(feeder, Feeder) and scenario.background.capacitors:
        q -= feeder.capacitor_kvar
    for power, drawn in ((p, p_kw or {}), (q, {bus: -more for bus, more in (q_kvar or {}).items()})):
        for bus, more in drawn.items():
            nodes = nodes_of(scenario, bus)
            power[feeder.first_device_leg + np.array(nodes)] += more / len(nodes)
    solution = solver_for(feeder, scenario.power_flow)(feeder, p, q, scenario.source_voltage_pu)
    return solution.v_pu if solution.converged else np.full(feeder.n_node, np.nan)


def inverters(runs: Runs) -> list[dict[str, Any]]:
    """For each published site, what 1 Mvar at the nearest and the farthest inverter does for it, and closed loops.

    Near and far is by X_ij, the shared reactance; the voltage of a bus is the mean over its phases. In the closed loops
    one inverter represents all seven (350 kvar).
    """
    records = []
    for site in runs.setting.sites:
        scenario = runs.setting.pinned((site,))
        feeder, full = scenario.feeder, {site: 280.0}
        x = sensitivity(feeder).by_q_pu_per_mvar[nodes_of(scenario, site)].mean(axis=0)
        shared = {bus: float(x[nodes_of(scenario, bus)].mean()) for bus in scenario.inverters.buses}
        ends = {"near": max(shared, key=shared.__getitem__), "far": min(shared, key=shared.__getitem__)}
        before = settled(scenario, full)
        record: dict[str, Any] = {"site": site}
        for name, bus in {"own": site, **ends}.items():
            rise = settled(scenario, full, {bus: 1000.0}) - before
            record |= {f"{name}_bus": int(bus), f"{name}_x_pu_per_mvar": float(x[nodes_of(scenario, bus)].mean())}
            record[f"{name}_rise_pu_per_mvar"] = float(rise[nodes_of(scenario, site)].mean())
        one_site = runs.setting.pinned((site,), inverters={"buses": (ends["near"],), "s_rated_kva": 350.0})
        record["none_site_deviation_pu"] = runs.run(one_site, NO_CONTROL).mean("first_site_deviation_pu")
        for name, bus in ends.items():
            one = runs.setting.pinned((site,), inverters={"buses": (bus,), "s_rated_kva": 350.0})
            record[f"{name}_site_deviation_pu"] = runs.run(one, INVERTERS).mean("first_site_deviation_pu")
        records.append(record)
    return records


def intervals(runs: Runs) -> list[dict[str, Any]]:
    """Two minutes with five data centres in steps of 0.1 s; the law acts every 0.1, 1 or 5 s.

    ``late_deviation_pu`` is the mean over the second half: an episode begins without reactive power, and a long
    interval takes its first step at once.
    """
    base = runs.setting.scenario(5)
    fine = make_scenario(base, dt_s=STEP_S, horizon=round(base.horizon * base.dt_s / STEP_S))
    records = []
    for k_p in (1.0, 10.0):
        for interval_s in INTERVALS_S:
            run = runs.run(fine, Law(k_p_mw_per_pu=k_p, hold_steps=round(interval_s / STEP_S)))
            records.append(
                {
                    "k_p_mw_per_pu": k_p,
                    "interval_s": interval_s,
                    "deviation_mean_pu": run.deviation_pu,
                    "late_deviation_pu": run.mean("late_deviation_pu"),
                    "J": run.mean("J"),
                    "delay_mean_s": run.mean("delay_mean_s"),
                    "unserved_pct": unserved_pct(run),
                }
            )
    return records
