"""Render the study's further tables and figures."""

from __future__ import annotations

from typing import Any

from dcgrid_env.apps.reproduction.markdown_tables import columns_table, table, wrapped
from docs.studies.paper.drawing import LABELS

Records = dict[str, Any]
COMPARED = ("none", "inverters", "both")
"""Laws of the comparison; the figures of the others are in the tables of Table I and of the gain."""


def render_details(records: Records) -> str:
    """Render the tables and figures that follow Table I and the claims."""
    parts = (_table_one, _comparison, _gains, _levers, _grids, _figures)
    return "\n\n".join(part(records) for part in parts)


def _table_one(records: Records) -> str:
    radius = {(r["n_datacenters"], r["k_p_mw_per_pu"]): r["spectral_radius"] for r in records["stability"]}
    by_setting: dict[tuple[int, float], dict[str, dict[str, Any]]] = {}
    for row in records["table_one"]:
        by_setting.setdefault((row["n_datacenters"], row["k_p_mw_per_pu"]), {})[row["memory"]] = row
    rows = []
    for (n, k_p), forms in by_setting.items():
        cells = [str(n), f"{k_p:g}"]
        for memory in ("cumulative", "one_step"):
            cells += [f"{forms[memory]['unserved_pct']:.1f}", f"{forms[memory]['J']:.3f}"]
        rows.append([*cells, f"{radius[n, k_p]:.2f}"])
    head = ["sites", "k_p (MW/p.u.)", "unserved (%)", "J", "one-step: unserved (%)", "one-step: J", "spectral radius"]
    return f"""## Unserved work and cost in Table I

Unserved work remains at the end of an episode. A spectral radius above 1 (linear loop, cumulative backlog, worst
placement) means that the clock oscillates: work is late and the voltage gains little.

{table(head, rows)}"""


def _comparison(records: Records) -> str:
    rows = [row | {"label": LABELS[row["law"]]} for row in records["comparison"] if row["law"] in COMPARED]
    columns = {
        "sites": ("n_datacenters", "d"),
        "law (k_p = 1)": ("label", "s"),
        "deviation (p.u.)": ("deviation_mean_pu", ".4f"),
        "std (p.u.)": ("deviation_std_pu", ".4f"),
        "mean abs(V²-1)": ("squared_deviation_mean_pu", ".4f"),
        "buses always inside (%)": ("buses_inside_pct", ".1f"),
        "lowest V (p.u.)": ("voltage_min_pu", ".3f"),
        "delay (s)": ("delay_mean_s", ".2f"),
        "J": ("J", ".3f"),
    }
    return (
        f"## No control, inverters only, both axes (Fig. 5)\n\n{_image(records, 5)}\n\n{columns_table(rows, columns)}"
    )


def _gains(records: Records) -> str:
    by_count: dict[int, list[dict[str, Any]]] = {}
    for row in records["gains"]:
        by_count.setdefault(row["n_datacenters"], []).append(row)
    forms = {"clock, cumulative": "gain_active_pct", "clock, one-step": "gain_active_one_step_pct"}
    head = ["sites", "reactive (%)"]
    head += [f"{form}, k_p = {row['k_p_mw_per_pu']:g} (%)" for form in forms for row in records["gains"][:3]]
    rows = [
        [str(n), f"{group[0]['gain_reactive_pct']:.1f}"]
        + [f"{row[key]:.2f}" for key in forms.values() for row in group]
        + [f"{max(row['standard_error_pct'] for row in group):.1f}", f"{group[0]['J_reactive']:.3f}"]
        for n, group in by_count.items()
    ]
    head += ["standard error (%)", "J: k_p = 0"]
    last = [r for r in records["gains"] if r["n_datacenters"] == 5][-1]
    printed, kept = last["gain_active_one_step_pct"], last["gain_active_pct"]
    share = f"{100.0 * (1.0 - max(kept, 0.0) / printed):.0f} %" if printed > max(kept, 0.0) else "none"
    late = (
        f"With five sites at k_p = {last['k_p_mw_per_pu']:g}, {share} of the clock's gain in the one-step form is work "
        f"that is not done in time: {last['unserved_one_step_pct']:.1f} % of the work remains unserved, compared with "
        f"{last['unserved_pct']:.1f} % in the cumulative form. J charges for waiting and is lowest without the clock."
        if last["J_reactive"] < min(last["J"], last["J_one_step"])
        else ""
    )
    return f"""## Source of the gain

The reactive gain is from inverters only to reactive power of all agents (k_p = 0), the clock's gain from there to both
axes, in % of the deviation with inverters only. The standard error is that of the total gain over episodes, the largest
of the three k_p.

{wrapped(late)}

{table(head, rows)}"""


def _levers(records: Records) -> str:
    axes = {
        "feeder": ("feeder", "s"),
        "r/x at the sites": ("r_over_x", ".2f"),
        "rise per MW shed (p.u.)": ("rise_pu_per_mw", ".4f"),
        "rise per Mvar (p.u.)": ("rise_pu_per_mvar", ".4f"),
        "deviation: none": ("none_deviation_pu", ".4f"),
        "active only": ("active_deviation_pu", ".4f"),
        "reactive only": ("reactive_deviation_pu", ".4f"),
        "both": ("both_deviation_pu", ".4f"),
        "J: none": ("none_J", ".3f"),
        "J: active only": ("active_J", ".3f"),
        "J: reactive only": ("reactive_J", ".3f"),
        "J: both": ("both_J", ".3f"),
    }
    return f"""## Active and reactive power

Voltage rises are at the site, at base load with all sites at their rating, from the exact power flow. Closed loops use
k_p = 10 MW/p.u.

{columns_table(records["axes"], axes)}"""


def _grids(records: Records) -> str:
    by_count: dict[int, dict[str, float]] = {}
    for row in records["grids"]:
        by_count.setdefault(row["n_datacenters"], {})[row["law"]] = row["lindistflow_pu"]
    laws = list(next(iter(by_count.values())))
    rows = [[str(n), *(f"{values[law]:.4f}" for law in laws)] for n, values in by_count.items()]
    text = "The deviation on the linear grid (LinDistFlow, p.u.). Compare it with the table of Fig. 5."
    return f"## Linear grid\n\n{text}\n\n{table(['sites', *(LABELS[law] for law in laws)], rows)}"


def _image(records: Records, number: int) -> str:
    figure = next(f for f in records["figures"] if f["figure"] == number)
    return f"![Fig. {number}]({figure['file']})\n\n*Fig. {number}: {figure['caption']}*"


def _figures(records: Records) -> str:
    images = [_image(records, number) for number in (1, 2, 3, 4, 6, 7)]
    more = wrapped(
        "`reproduction.json` contains further figures: near and far inverters, bus 13 and the control interval."
    )
    return "## Other figures\n\n" + "\n\n".join((*images, more))
