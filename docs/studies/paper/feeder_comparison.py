"""Compare the study on several forms of the IEEE 123 node feeder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dcgrid_env.apps.reproduction.paper import COUNTS, K_P_MW_PER_PU
from dcgrid_env.apps.reproduction.study import studies
from dcgrid_env.apps.reproduction.study_runs import Law, Run, Runs, Setting
from dcgrid_env.apps.reproduction.table1 import LAWS
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Place
from docs.studies.paper.drawing import LABELS
from docs.studies.paper.feeder_cases import cases, setting_of
from docs.studies.paper.further_parts import ALL_PARTS
from docs.studies.paper.ranking import Rows, agreement

Records = dict[str, Any]
PARTS = {
    part: ALL_PARTS[part]
    for part in ("table_one", "stability", "comparison", "gains", "inverters", "bus_thirteen", "intervals")
}
"""Parts of the study that depend on the form of the feeder and need no other feeder and no linear power flow."""
LEFT_OUT = {
    "linear and nonlinear grid are not qualitatively different": "the package has no linear three-phase power flow",
    "active power is the stronger lever where r/x is high": "it compares feeders",
    "Fig. 3: without regulation the voltage can float high after a change in compute load": "it uses the "
    "six-bus feeder",
    "tap changers are too slow for dips of a second or less": "the reproduction tests it on this feeder",
    "ramps of 10 to 20 % dominate": "it is about the load",
    "Llama 3 405B is not more dynamic than models of middle size": "it is about the load",
}
"""Claims that the comparison leaves out, and why."""
RANKED = {"deviation": "voltage_deviation_mean_pu", "J": "J"}
"""Rankings of rows: name and metric."""


def compare_feeders(
    setting: Setting, on_part: Callable[[str], None] = lambda part: None, place: Place = ONE_PROCESS
) -> Records:
    """Run the study on every form of the feeder with the same load, gains and episodes.

    Parameters
    ----------
    setting
        Load, number of episodes and placement; the feeder is each form's.
    on_part
        Called with what is done, ``len(PARTS)`` times for each form.
    place
        Where the parts are run.

    Returns
    -------
    JSON values. ``setting``; ``cases``, for each form its ``label``, ``about`` and the records of the study.
    ``orders``, the rank of rows in each form against the balanced one. ``causes``, figures that change from form to
    form. ``equipment``, moves of regulators and unbalance of voltages.
    """
    forms = cases()
    runs = {name: Runs(setting_of(case, setting)) for name, case in forms.items()}
    done = studies(runs, PARTS, lambda name, part: on_part(f"{forms[name].label}: {part.replace('_', ' ')}"), place)
    found = {name: {"label": case.label, "about": case.about} | done[name] for name, case in forms.items()}
    return {
        "setting": found["balanced"]["setting"],
        "cases": found,
        "orders": [record for name in list(forms)[1:] for record in orders(runs["balanced"], runs[name], name)],
        "causes": causes(runs, found),
        "equipment": [record for name in forms for record in equipment(runs[name], name)],
    }


def orders(balanced: Runs, other: Runs, name: str) -> list[Records]:
    """How another form of the feeder ranks the rows of Table I, (sites, k_p), and the laws at each number of sites."""
    return [
        {"case": name, "rows": rows, "by": by} | agreement(make(balanced, metric), make(other, metric))
        for rows, make in (("table_one", _table_rows), ("laws", _law_rows))
        for by, metric in RANKED.items()
    ]


def _table_rows(runs: Runs, metric: str) -> dict[str, Rows]:
    rows = {
        f"({n}, {k_p:g})": runs.run(runs.setting.scenario(n), Law(k_p_mw_per_pu=k_p)).each(metric)
        for n in COUNTS
        for k_p in K_P_MW_PER_PU
    }
    return {"": rows}


def _law_rows(runs: Runs, metric: str) -> dict[str, Rows]:
    return {
        str(n): {LABELS[law]: runs.run(runs.setting.scenario(n), LAWS[law]).each(metric) for law in LAWS}
        for n in COUNTS
    }


def causes(runs: Mapping[str, Runs], found: Mapping[str, Records]) -> list[Records]:
    """Figures of each form, to compare with those of the form before."""

    def over_counts(name: str, law: str, figure: Callable[[Run], float]) -> float:
        case_runs = runs[name]
        return float(np.mean([figure(case_runs.run(case_runs.setting.scenario(n), LAWS[law])) for n in COUNTS]))

    def gain(name: str) -> float:
        rows = [r for r in found[name]["gains"] if r["k_p_mw_per_pu"] == 1.0 and r["n_datacenters"] in COUNTS]
        return float(np.mean([r["gain_reactive_pct"] + r["gain_active_pct"] for r in rows]))

    def rise(name: str) -> float:
        rows = {r["n_datacenters"]: r for r in found[name]["comparison"] if r["law"] == "none"}
        return rows[COUNTS[-1]]["deviation_mean_pu"] - rows[COUNTS[0]]["deviation_mean_pu"]

    def delay(name: str) -> float:
        rows = [r for r in found[name]["table_one"] if r["n_datacenters"] == 5 and r["memory"] == "cumulative"]
        return rows[-1]["delay_mean_s"]

    def by_one_mvar(name: str) -> float:
        return float(np.mean([r["own_rise_pu_per_mvar"] for r in found[name]["inverters"]]))

    figures: dict[tuple[str, str], Callable[[str], float]] = {
        (f"deviation, {LABELS[law]} (p.u.)", ".4f"): lambda name, law=law: over_counts(
            name, law, lambda run: run.deviation_pu
        )
        for law in ("none", "inverters", "both")
    }
    figures |= {
        ("gain of both axes over inverters only (%)", ".1f"): gain,
        ("deviation, no control: 5 sites less 1 site (p.u.)", "+.4f"): rise,
        ("nodes above 1 p.u., no control (% of time)", ".0f"): lambda name: over_counts(
            name, "none", lambda run: run.mean("above_1pu_pct")
        ),
        ("rise of the voltage at a site by 1 Mvar there (p.u.)", ".4f"): by_one_mvar,
        ("delay, 5 sites at k_p = 20 (s)", ".2f"): delay,
    }
    return [
        {"figure": text, "format": how, "values": {name: figure(name) for name in runs}}
        for (text, how), figure in figures.items()
    ]


def equipment(runs: Runs, name: str) -> list[Records]:
    """Taps that regulators make, voltage unbalance and the highest voltage with five sites; empty where balanced."""
    records = []
    for law in ("none", "inverters", "both"):
        run = runs.run(runs.setting.scenario(5), LAWS[law])
        if "tap_moves" in run.episodes[0]:
            records.append(
                {
                    "case": name,
                    "law": law,
                    "tap_moves": run.mean("tap_moves"),
                    "unbalance_mean_pct": run.mean("unbalance_mean_pct"),
                    "unbalance_max_pct": float(run.each("unbalance_max_pct").max()),
                    "voltage_min_pu": float(run.each("voltage_min_pu").min()),
                    "voltage_max_pu": float(run.each("voltage_max_pu").max()),
                }
            )
    return records
