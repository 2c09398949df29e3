"""The written result: Markdown made of the records alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.baselines.reproduction.markdown_details import render_details
from dcgrid_env.baselines.reproduction.markdown_guesses import render_guesses
from dcgrid_env.baselines.reproduction.markdown_tables import table, wrapped
from dcgrid_env.baselines.reproduction.paper import RECORDING, TABLE_ONE
from dcgrid_env.baselines.reproduction.public_code import render_limits
from dcgrid_env.baselines.reproduction.verdict import VERDICTS
from dcgrid_env.core.versions import code_block

Records = dict[str, Any]


def render(records: Records) -> str:
    """Markdown of the records of ``reproduce.study``, to which ``meta`` and ``figures`` have been added."""
    parts = (_head, _table_one, _claims, render_guesses, _limits, render_details)
    return "\n\n".join(part(records) for part in parts) + "\n"


def where_sites_stand(setting: Records) -> str:
    """Where the data centres of a study's setting stand."""
    if setting["placement"] == "published":
        return f"at the first n of the buses {', '.join(map(str, setting['sites']))} of the public code"
    return "drawn among the load buses, separately in each episode"


def load_note(setting: Records) -> str:
    """Source of the paper's recording, or how to use it; empty for a load that is unrelated to it."""
    if setting["load"] == "generated":
        return (
            f" The paper's own recording is used where `dcgrid traces fetch {RECORDING}` has put it into the cache, or "
            "`--trace FILE` names it."
        )
    if RECORDING in setting["load_description"]:
        return f" `dcgrid traces fetch {RECORDING}` puts the recording into the cache."
    return ""


def _head(records: Records) -> str:
    s = records["setting"]
    verdicts = [row["verdict"] for row in records["claims"]]
    counted = ", ".join(f"{verdicts.count(verdict)} *{verdict}*" for verdict in VERDICTS)
    order = (
        "This page compares the paper's results with ours: Table I first, then each claim, then what cannot be "
        "reproduced and why; the tables behind them follow. Of the "
        f"{len(verdicts)} claims: {counted}."
    )
    setting = (
        f"Scenario `ieee123`: {s['episodes']} episodes of 120 s for each cell, data centres {where_sites_stand(s)}. "
        f"Load: **{s['load']}**, {s['load_description']}. Figures are means over episodes unless they say otherwise. "
        "Deviation is abs(V - 1) over all buses but the substation and all seconds; its standard deviation is that of "
        "an episode. k_p is the paper's, in MW/p.u.; k_q = 0.5 Mvar/(p.u. s) and alpha = 0.3 /s are the defaults here. "
        "Nothing is tuned. Equation (5) is applied with the sign that it has for a load, and work cannot be served "
        f"before it arrives.{load_note(s)}"
    )
    beside = (
        "Here the feeder is a balanced single-phase equivalent. `dcgrid reproduce --scenario ieee123-3ph` repeats "
        "Table I and the claims on the feeder with its phases and its regulators. "
        "[reproduction-3ph.md](reproduction-3ph.md) compares both."
    )
    title = f"# The paper's study, run again\n\n{s['paper']}.\n\n{wrapped(order)}"
    command = code_block(records["meta"]["command"])
    return "\n\n".join((title, "Made by", command, wrapped(setting), wrapped(beside)))


def _table_one(records: Records) -> str:
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
    head = ["sites", "k_p", "paper: deviation (p.u.)", "ours: volts", "ours: squared voltage"]
    head += ["paper: delay (s)", "ours: backlog kept", "ours: one-step backlog"]
    text = (
        "The 30 numbers of Table I and their standard deviations, next to ours with the defaults. The paper reports "
        "the voltage magnitude and its public code computes V². Both are listed: abs(V - 1) and abs(V² - 1). The "
        "backlog is kept until it is served, or forgotten after a step, as equation (6) prints it. The last row "
        "is the mean absolute difference from the paper over the 15 cells."
    )
    return f"## Table I\n\n{wrapped(text)}\n\n{table(head, rows)}\n\n{wrapped(_reading(errors))}"


def _reading(errors: list[list[float]]) -> str:
    """What Table I shows, in words."""
    volts, squared = np.array(errors).T[:2]
    paper = np.array([cell.deviation_pu for cell in TABLE_ONE.values()])
    shares = [100.0 * float((paper + error).mean() / paper.mean()) for error in (volts, squared)]
    return (
        f"In volts our deviation is {shares[0]:.0f} % of the paper's on average, in squared voltage {shares[1]:.0f} %. "
        "The trends over sites and over k_p are in the claims below."
    )


def _claims(records: Records) -> str:
    keys = ("claim", "paper", "ours", "verdict", "reason")
    rows = [[row[key] for key in keys] for row in records["claims"]]
    return "## Claims\n\n" + table(("claim", "paper", "ours", "verdict", "why"), rows)


def _limits(records: Records) -> str:
    return render_limits()
