"""Table I, the comparison behind Fig. 5, and where its gain comes from."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.apps.reproduction.paper import K_P_MW_PER_PU
from dcgrid_env.apps.reproduction.study_runs import BOTH, INVERTERS, NO_CONTROL, REACTIVE, Law, Run, Runs

LAWS = {
    "none": NO_CONTROL,
    "inverters": INVERTERS,
    "reactive": REACTIVE,
    "both": BOTH,
    "both-one-step": BOTH._replace(memory="one_step"),
}
"""The steps from no control to the whole law; ``reactive`` is all agents with k_p = 0, ``both`` k_p = 1."""


def figures(run: Run) -> dict[str, float]:
    """The figures of a run that the tables hold: means over episodes, shares over all of them."""
    return {
        "J": run.mean("J"),
        "deviation_mean_pu": run.deviation_pu,
        "deviation_std_pu": run.mean("voltage_deviation_std_pu"),
        "squared_deviation_mean_pu": run.mean("squared_deviation_mean_pu"),
        "squared_deviation_std_pu": run.mean("squared_deviation_std_pu"),
        "buses_inside_pct": 100.0 - run.mean("outside_buses_pct"),
        "voltage_min_pu": float(run.each("voltage_min_pu").min()),
        "delay_mean_s": run.mean("delay_mean_s"),
        "unserved_kws": run.mean("unserved_kws"),
        "unserved_pct": unserved_pct(run),
    }


def unserved_pct(run: Run) -> float:
    """Work left in the queue at the end as a share of the work that arrived, over all episodes, %."""
    arrived = run.each("arrived_kws").sum()
    return float(100.0 * run.each("unserved_kws").sum() / arrived) if arrived else 0.0


def table_one(runs: Runs) -> list[dict[str, Any]]:
    """Table I: each number of data centres and k_p, in both forms of the backlog."""
    return [
        {"n_datacenters": n, "k_p_mw_per_pu": k_p, "memory": memory}
        | figures(runs.run(runs.setting.scenario(n), Law(k_p_mw_per_pu=k_p, memory=memory)))
        for n in runs.setting.counts
        for k_p in K_P_MW_PER_PU
        for memory in ("cumulative", "one_step")
    ]


def comparison(runs: Runs) -> list[dict[str, Any]]:
    """Fig. 5: from no control to the whole law, against the number of data centres."""
    return [
        {"n_datacenters": n, "law": name} | figures(runs.run(runs.setting.scenario(n), law))
        for n in runs.setting.counts
        for name, law in LAWS.items()
    ]


def grids(runs: Runs) -> list[dict[str, Any]]:
    """Table I on the linearised grid: mean abs(V - 1) under DistFlow and LinDistFlow."""
    records = []
    for n in runs.setting.counts:
        for name in ("none", "inverters", "both"):
            exact = runs.run(runs.setting.scenario(n), LAWS[name]).deviation_pu
            linear = runs.run(runs.setting.scenario(n, power_flow="lindistflow"), LAWS[name]).deviation_pu
            records.append({"n_datacenters": n, "law": name, "distflow_pu": exact, "lindistflow_pu": linear})
    return records


def gains(runs: Runs) -> list[dict[str, Any]]:
    """How far each step brings mean abs(V - 1) below inverters only, in % of that, and what it costs.

    ``reactive`` is the gain by the data centres' converters, ``active`` the further gain by the clock, in both forms of
    the backlog. ``standard_error_pct`` is that of the whole gain (cumulative) over episodes, paired.
    """
    records = []
    for n in runs.setting.counts:
        scenario = runs.setting.scenario(n)
        inverters, reactive = runs.run(scenario, INVERTERS), runs.run(scenario, REACTIVE)
        base = inverters.deviation_pu
        for k_p in K_P_MW_PER_PU:
            whole, printed = (
                runs.run(scenario, Law(k_p_mw_per_pu=k_p, memory=memory)) for memory in ("cumulative", "one_step")
            )
            paired = inverters.each("voltage_deviation_mean_pu") - whole.each("voltage_deviation_mean_pu")
            spread = float(paired.std(ddof=1) / np.sqrt(len(paired)))
            records.append(
                {
                    "n_datacenters": n,
                    "k_p_mw_per_pu": k_p,
                    "inverters_pu": base,
                    "gain_reactive_pct": 100.0 * (base - reactive.deviation_pu) / base,
                    "gain_active_pct": 100.0 * (reactive.deviation_pu - whole.deviation_pu) / base,
                    "gain_active_one_step_pct": 100.0 * (reactive.deviation_pu - printed.deviation_pu) / base,
                    "standard_error_pct": 100.0 * spread / base,
                    "unserved_pct": unserved_pct(whole),
                    "unserved_one_step_pct": unserved_pct(printed),
                    "J_inverters": inverters.mean("J"),
                    "J_reactive": reactive.mean("J"),
                    "J": whole.mean("J"),
                    "J_one_step": printed.mean("J"),
                }
            )
    return records
