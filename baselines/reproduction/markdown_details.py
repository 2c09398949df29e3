"""The study's further tables and figures, behind Table I and the claims."""

from __future__ import annotations

from typing import Any

from dcgrid_env.baselines.reproduction.drawing import LABELS
from dcgrid_env.baselines.reproduction.markdown_tables import columns_table, table, wrapped

Records = dict[str, Any]


def render_details(records: Records) -> str:
    """Everything that a reader who wants Table I and the claims alone may skip."""
    parts = (_table_one, _comparison, _gains, _levers, _bus_thirteen, _intervals, _grids, _figures)
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
            r = forms[memory]
            cells.append(f"{r['deviation_mean_pu']:.4f} ± {r['deviation_std_pu']:.4f}")
            cells += [f"{r['delay_mean_s']:.2f}", f"{r['unserved_pct']:.1f}", f"{r['J']:.3f}"]
        rows.append([*cells, f"{radius[n, k_p]:.2f}"])
    four = ("deviation (p.u.)", "delay (s)", "unserved (%)", "J")
    head = ["sites", "k_p (MW/p.u.)", *four, *(f"one-step: {name}" for name in four), "spectral radius"]
    return f"""## Table I with unserved work and cost

Ours alone, with the cumulative backlog and with the one-step form that the paper prints. The column next to
the delay is the work left unserved at the end. A spectral radius above 1 (linear loop, cumulative, the worst of the
placements) means that the clock oscillates: work comes late and the voltage gains little.

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
    return f"## No control, inverters only, both (Fig. 5)\n\n{_image(records, 5)}\n\n{columns_table(rows, columns)}"


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

{columns_table(records["gains"], columns)}

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

{columns_table(records["axes"], axes)}

## Near and far inverters

Near and far by the reactance shared with the data centre; what 1 Mvar there does for the site's voltage, and the
site's deviation with one inverter of 350 kvar under droop in place of the seven.

{columns_table(records["inverters"], inverters)}"""


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

{columns_table(records["intervals"], columns)}"""


def _grids(records: Records) -> str:
    rows = [row | {"label": LABELS[row["law"]]} for row in records["grids"]]
    columns = {
        "sites": ("n_datacenters", "d"),
        "law": ("label", "s"),
        "DistFlow (p.u.)": ("distflow_pu", ".4f"),
        "LinDistFlow (p.u.)": ("lindistflow_pu", ".4f"),
    }
    return "## Linear and nonlinear grid\n\nDeviation.\n\n" + columns_table(rows, columns)


def _image(records: Records, number: int) -> str:
    figure = next(f for f in records["figures"] if f["figure"] == number)
    return f"![Fig. {number}]({figure['file']})\n\n*Fig. {number}: {figure['caption']}*"


def _figures(records: Records) -> str:
    images = [_image(records, number) for number in (1, 2, 3, 4, 6, 7)]
    return "## Counterparts of the paper's other figures\n\n" + "\n\n".join(images)
