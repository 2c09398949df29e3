"""The written result: Markdown made of the records alone."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

from dcgrid_env.baselines.reproduction.drawing import LABELS
from dcgrid_env.baselines.reproduction.paper import RECORDING

Records = dict[str, Any]


def render(records: Records) -> str:
    """Markdown of the records of ``reproduce.study``, to which ``meta`` and ``figures`` have been added."""
    parts = (_head, _claims, _table_one, _comparison, _gains, _levers, _bus_thirteen, _intervals, _grids, _figures)
    return "\n\n".join(part(records) for part in parts) + "\n"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _columns(rows: Sequence[dict[str, Any]], columns: dict[str, tuple[str, str]]) -> str:
    """A table of records: heading -> (key, format)."""
    cells = [[format(row[key], how) for key, how in columns.values()] for row in rows]
    return table(list(columns), cells)


def wrapped(text: str) -> str:
    """A paragraph in lines of 120 columns."""
    return textwrap.fill(text, width=120, break_on_hyphens=False, break_long_words=False)


def where_sites_stand(setting: Records) -> str:
    """Where the data centres of a study's setting stand."""
    if setting["placement"] == "published":
        return f"at the first n of the buses {', '.join(map(str, setting['sites']))} of the public code"
    return "drawn among the load buses, anew in each episode"


def load_note(setting: Records) -> str:
    """Where the paper's recording comes from, or is to be had; empty for a load that has nothing to do with it."""
    if setting["load"] == "generated":
        return (
            f" The paper's own recording is used where `dcgrid traces fetch {RECORDING}` has put it into the cache, or "
            "`--trace FILE` names it."
        )
    if RECORDING in setting["load_description"]:
        return f" The recording is what `dcgrid traces fetch {RECORDING}` puts into the cache."
    return ""


def _head(records: Records) -> str:
    s = records["setting"]
    setting = (
        f"on the scenario `ieee123`: {s['episodes']} episodes of 120 s for each cell, data centres "
        f"{where_sites_stand(s)}. Load: **{s['load']}**, {s['load_description']}. Figures are means over episodes "
        "unless they say otherwise; deviation is abs(V - 1) over all buses but the substation and all seconds, and its "
        "standard deviation is that of an episode. k_p is the paper's, k_q = 0.5 Mvar/(p.u. s) and alpha = 0.3 /s are "
        "the defaults here; nothing is tuned."
    )
    known = (
        "The paper's figures are those that its text reports. The other cells of its Table I were not at hand and are "
        "left out. The law is applied with its signs put right for loads, and work cannot be served before it arrives."
    )
    known += load_note(s)
    command = f"    {records['meta']['command']}"
    beside = (
        "Here the feeder is a balanced single-phase equivalent. `dcgrid reproduce --scenario ieee123-3ph` repeats "
        "Table I and the claims on the feeder with its phases and its regulators, beside these: "
        "[reproduction-3ph.md](reproduction-3ph.md)."
    )
    title = f"# The paper's study, run again\n\n{s['paper']}.\n\n{wrapped(beside)}"
    return "\n\n".join((title, "Made by", command, wrapped(setting), wrapped(known)))


def _claims(records: Records) -> str:
    keys = ("claim", "paper", "ours", "verdict", "reason")
    rows = [[row[key] for key in keys] for row in records["claims"]]
    return "## Claims\n\n" + table(("claim", "paper", "ours", "verdict", "why"), rows)


def _table_one(records: Records) -> str:
    radius = {(r["n_datacenters"], r["k_p_mw_per_pu"]): r["spectral_radius"] for r in records["stability"]}
    by_setting: dict[tuple[int, float], dict[str, dict[str, Any]]] = {}
    for row in records["table_one"]:
        by_setting.setdefault((row["n_datacenters"], row["k_p_mw_per_pu"]), {})[row["memory"]] = row
    rows = []
    for (n, k_p), forms in by_setting.items():
        cells = [str(n), f"{k_p:g}"]
        for memory in ("cumulative", "one_step"):
            r = forms[memory]
            cells.append(f"{r['deviation_mean_pu']:.4f} ± {r['deviation_std_pu']:.4f}")
            cells += [f"{r['delay_mean_s']:.2f}", f"{r['unserved_pct']:.1f}", f"{r['J']:.3f}"]
        rows.append([*cells, f"{radius[n, k_p]:.2f}"])
    four = ("deviation (p.u.)", "delay (s)", "unserved (%)", "J")
    head = ["sites", "k_p (MW/p.u.)", *four, *(f"one-step: {name}" for name in four), "spectral radius"]
    return f"""## Table I

Mean and standard deviation of abs(V - 1) and mean delay, with the cumulative backlog and with the one-step form that
the paper prints; beside the delay the work left unserved at the end. A spectral radius above 1 (linear loop,
cumulative, the worst of the placements) says that the clock oscillates: work comes late and the voltage gains little.

{table(head, rows)}"""


def _comparison(records: Records) -> str:
    rows = [row | {"label": LABELS[row["law"]]} for row in records["comparison"]]
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
    return f"## No control, inverters only, both (Fig. 5)\n\n{_image(records, 5)}\n\n{_columns(rows, columns)}"


def _gains(records: Records) -> str:
    columns = {
        "sites": ("n_datacenters", "d"),
        "k_p (MW/p.u.)": ("k_p_mw_per_pu", "g"),
        "inverters only (p.u.)": ("inverters_pu", ".4f"),
        "gain, reactive (%)": ("gain_reactive_pct", ".1f"),
        "gain, clock (%)": ("gain_active_pct", ".2f"),
        "gain, clock, one-step (%)": ("gain_active_one_step_pct", ".2f"),
        "standard error (%)": ("standard_error_pct", ".1f"),
        "J inverters": ("J_inverters", ".3f"),
        "J reactive": ("J_reactive", ".3f"),
        "J both": ("J", ".3f"),
        "J both, one-step": ("J_one_step", ".3f"),
    }
    last = [r for r in records["gains"] if r["n_datacenters"] == 5][-1]
    printed, kept = last["gain_active_one_step_pct"], last["gain_active_pct"]
    share = f"{100.0 * (1.0 - max(kept, 0.0) / printed):.0f} %" if printed > max(kept, 0.0) else "none"
    undone = (
        f"How much of the printed law's gain is work not done: with five sites at k_p = {last['k_p_mw_per_pu']:g} its "
        f"clock gains {printed:.2f} points and leaves {last['unserved_one_step_pct']:.1f} % of the work unserved; with "
        f"the backlog kept it gains {kept:.2f} and leaves {last['unserved_pct']:.1f} %. So {share} of what the printed "
        "clock gains is work not done in time, and J, which charges for waiting, says "
        f"{last['J_one_step']:.3f} against {last['J']:.3f}, and {last['J_reactive']:.3f} without the clock."
    )
    return f"""## Where the gain comes from

From inverters only to reactive power of all agents (k_p = 0), and from there to the clock as well, in % of the
deviation with inverters only. The standard error is that of the whole gain over episodes.

{_columns(records["gains"], columns)}

{wrapped(undone)}"""


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
    inverters = {
        "site": ("site", "d"),
        "nearest": ("near_bus", "d"),
        "X (p.u./Mvar)": ("near_x_pu_per_mvar", ".4f"),
        "1 Mvar there (p.u.)": ("near_rise_pu_per_mvar", ".4f"),
        "farthest": ("far_bus", "d"),
        "X far": ("far_x_pu_per_mvar", ".4f"),
        "1 Mvar far (p.u.)": ("far_rise_pu_per_mvar", ".4f"),
        "1 Mvar at the site (p.u.)": ("own_rise_pu_per_mvar", ".4f"),
        "deviation of the site: none": ("none_site_deviation_pu", ".4f"),
        "350 kvar near": ("near_site_deviation_pu", ".4f"),
        "350 kvar far": ("far_site_deviation_pu", ".4f"),
    }
    return f"""## Active against reactive power

Rises are at the site itself, at base load with the sites at their rating, from the exact power flow; closed loops at
k_p = 10 MW/p.u.

{_columns(records["axes"], axes)}

## Near and far inverters

Near and far by the reactance shared with the data centre; what 1 Mvar there does for the site's voltage, and the
site's deviation with one inverter of 350 kvar under droop in place of the seven.

{_columns(records["inverters"], inverters)}"""


def _bus_thirteen(records: Records) -> str:
    b = records["bus_thirteen"]

    def draw(kw: float | None) -> str:
        return "more than can be asked for" if kw is None else f"{kw:.0f} kW"

    rows = [
        ["lowest voltage in the runs, its own data centre alone (p.u.)", f"{b['alone_min_pu']:.4f}"],
        ["the same with sites at 13, 24, 28, 37 and 53 (p.u.)", f"{b['five_min_pu']:.4f}"],
        ["the same with the substation at 1.0 p.u. (p.u.)", f"{b['five_at_1pu_min_pu']:.4f}"],
        ["base load, no data centre (p.u.)", f"{b['base_pu']:.4f}"],
        ["drop by its own 280 kW (p.u.)", f"{b['drop_own_pu']:.4f}"],
        ["drop by the four others' (p.u.)", f"{b['drop_neighbours_pu']:.4f}"],
        ["draw at which it leaves the band, beside the four", draw(b["leaves_band_kw"])],
        ["draw at which it leaves the band, alone", draw(b["leaves_band_alone_kw"])],
        ["base load, no data centre, substation at 1.0 p.u. (p.u.)", f"{b['base_at_1pu']:.4f}"],
        ["the same squared, as the public code plots it", f"{b['base_at_1pu_squared']:.4f}"],
    ]
    return "## Bus 13 with inverters only\n\n" + table(("", "bus 13"), rows)


def _intervals(records: Records) -> str:
    columns = {
        "k_p (MW/p.u.)": ("k_p_mw_per_pu", "g"),
        "interval (s)": ("interval_s", "g"),
        "deviation (p.u.)": ("deviation_mean_pu", ".4f"),
        "second minute (p.u.)": ("late_deviation_pu", ".4f"),
        "J": ("J", ".4f"),
        "delay (s)": ("delay_mean_s", ".2f"),
        "unserved (%)": ("unserved_pct", ".1f"),
    }
    return f"""## Control interval

The same two minutes with five sites, simulated in steps of 0.1 s throughout; voltage and backlog are measured and the
reactive setpoint is moved once in each interval, while the load's own p_ref passes. k_q and alpha are per second and
k_p is per p.u., so no gain is scaled. An episode begins without reactive power and the 5 s law takes its first step
of 5 s at once; the second minute is free of that.

{_columns(records["intervals"], columns)}"""


def _grids(records: Records) -> str:
    rows = [row | {"label": LABELS[row["law"]]} for row in records["grids"]]
    columns = {
        "sites": ("n_datacenters", "d"),
        "law": ("label", "s"),
        "DistFlow (p.u.)": ("distflow_pu", ".4f"),
        "LinDistFlow (p.u.)": ("lindistflow_pu", ".4f"),
    }
    return "## Linear and nonlinear grid\n\nDeviation.\n\n" + _columns(rows, columns)


def _image(records: Records, number: int) -> str:
    figure = next(f for f in records["figures"] if f["figure"] == number)
    return f"![Fig. {number}]({figure['file']})\n\n*Fig. {number}: {figure['caption']}*"


def _figures(records: Records) -> str:
    images = [_image(records, number) for number in (1, 2, 3, 4, 6, 7)]
    return "## Counterparts of the paper's other figures\n\n" + "\n\n".join(images)
