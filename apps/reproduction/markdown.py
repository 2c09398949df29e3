"""Render the study's records as Markdown."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.apps.reproduction.markdown_tables import table, wrapped
from dcgrid_env.apps.reproduction.paper import RECORDING, TABLE_ONE
from dcgrid_env.apps.reproduction.verdict import DOES_NOT, VERDICTS
from dcgrid_env.core.versions import code_block

Records = dict[str, Any]


def render(records: Records) -> str:
    """Return the Markdown page for the records of ``study``, with ``meta`` added to them."""
    return "\n\n".join(part(records) for part in (head, claims_table, table_one)) + "\n"


def site_placement(setting: Records) -> str:
    """Describe the buses of the data centres."""
    if setting["placement"] == "published":
        return f"at the first n of the buses {', '.join(map(str, setting['sites']))} of the public code"
    return "at load buses that are drawn in each episode"


def load_note(setting: Records) -> str:
    """Explain how to obtain the paper's recording; empty if the load is unrelated to it."""
    if setting["load"] == "generated":
        return f" To use the paper's recording, run `dcgrid traces fetch {RECORDING}` or pass `--trace FILE`."
    if RECORDING in setting["load_description"]:
        return f" `dcgrid traces fetch {RECORDING}` downloads the recording."
    return ""


def head(records: Records) -> str:
    """Return the title, the summary and the setting."""
    s = records["setting"]
    verdicts = [row["verdict"] for row in records["claims"]]
    holds, partly, does_not = (verdicts.count(verdict) for verdict in VERDICTS)
    purpose = (
        f"This page compares the results of {s['paper']}, with results of this project. It is for readers who want to "
        "know how far the paper can be reproduced."
    )
    gain = next(row for row in records["claims"] if row["claim"].startswith("average gain"))
    failed = [row["claim"] for row in records["claims"] if row["verdict"] == DOES_NOT]
    summary_lines = [
        f"Of the paper's {len(verdicts)} claims, {holds} hold, {partly} hold in part and {does_not} do not.",
        *(f"*{claim}* does not hold." for claim in failed),
        f"The gain over inverters only is {gain['ours']} (paper {gain['paper']}). {gain['reason']}.",
        "Table I cannot be reproduced to the digit, because the paper does not state all of its settings.",
    ]
    summary = "\n".join(wrapped(f"- {line}", "  ") for line in summary_lines)
    setting = (
        f"Scenario `ieee123`: {s['episodes']} episodes of 120 s for each cell, data centres {site_placement(s)}. "
        f"Load: **{s['load']}**, {s['load_description']}.{load_note(s)} Figures are means over episodes unless stated "
        "otherwise. The deviation is abs(V - 1) over all buses except the substation and all seconds, and its standard "
        "deviation is that of an episode. k_p is the paper's, in MW/p.u. Nothing is tuned: k_q = 0.5 Mvar/(p.u. s) and "
        "alpha = 0.3 /s are the defaults of this project. Equation (5) has the sign for a load, and work cannot be "
        "served before it arrives. *One-step* is the backlog of equation (6) as printed, which forgets work after a "
        "step. *Cumulative* keeps work until it is served."
    )
    command = code_block(records["meta"]["command"])
    parts = ("# Reproduction of the paper's study", wrapped(purpose), "Made by", command, summary)
    return "\n\n".join((*parts, "## Setting", wrapped(setting)))


def table_one(records: Records) -> str:
    """Return Table I next to the paper's."""
    by_cell: dict[tuple[int, float], dict[str, Records]] = {}
    for row in records["table_one"]:
        by_cell.setdefault((row["n_datacenters"], row["k_p_mw_per_pu"]), {})[row["memory"]] = row
    rows, errors = [], []
    for cell, paper in TABLE_ONE.items():
        kept, printed = by_cell[cell]["cumulative"], by_cell[cell]["one_step"]
        volts, squared = kept["deviation_mean_pu"], kept["squared_deviation_mean_pu"]
        delays = (kept["delay_mean_s"], printed["delay_mean_s"])
        rows.append(
            [
                str(cell[0]),
                f"{cell[1]:g}",
                f"{paper.deviation_pu:.3f} ± {paper.std_pu:.3f}",
                f"{volts:.4f} ± {kept['deviation_std_pu']:.4f}",
                f"{squared:.4f} ± {kept['squared_deviation_std_pu']:.4f}",
                f"{paper.delay_s:.1f}",
                *(f"{delay:.2f}" for delay in delays),
            ]
        )
        errors.append([volts - paper.deviation_pu, squared - paper.deviation_pu, *(d - paper.delay_s for d in delays)])
    error = np.abs(errors).mean(axis=0)
    mean = [f"{error[0]:.4f}", f"{error[1]:.4f}", "", *(f"{e:.2f}" for e in error[2:])]
    rows.append(["mean error", "", "", *mean])
    columns = ["sites", "k_p", "paper: deviation (p.u.)", "ours: V", "ours: V²"]
    columns += ["paper: delay (s)", "ours: cumulative", "ours: one-step"]
    text = (
        "The paper reports the voltage magnitude, but its public code computes V². The columns list both: abs(V - 1) "
        "and abs(V² - 1). The last row is the mean absolute difference from the paper over the 15 cells."
    )
    return f"## Table I\n\n{wrapped(_reading(errors))}\n\n{wrapped(text)}\n\n{table(columns, rows)}"


def _reading(errors: list[list[float]]) -> str:
    """Summarise the level of the deviations."""
    volts, squared = np.array(errors).T[:2]
    paper = np.array([cell.deviation_pu for cell in TABLE_ONE.values()])
    shares = [100.0 * float((paper + error).mean() / paper.mean()) for error in (volts, squared)]
    return (
        f"On average, the deviation of V is {shares[0]:.0f} % of the paper's and that of V² is {shares[1]:.0f} %. The "
        "claims describe the trends over sites and k_p."
    )


def claims_table(records: Records) -> str:
    """Return the table of claims."""
    keys = ("claim", "paper", "ours", "verdict", "reason")
    rows = [[row[key] for key in keys] for row in records["claims"]]
    return "## Claims\n\n" + table(("claim", "paper", "ours", "verdict", "reason"), rows)
