"""Render the study on several forms of the feeder as Markdown."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

from dcgrid_env.apps.reproduction.markdown import load_note, site_placement, table, wrapped
from dcgrid_env.core.versions import code_block
from docs.studies.paper.drawing import LABELS
from docs.studies.paper.feeder_comparison import LEFT_OUT
from docs.studies.paper.ranking import ranks

Records = dict[str, Any]
Table = tuple[list[str], list[list[str]]]
"""Headings and rows."""
SWAPS_SHOWN = 12
"""Number of swapped pairs that are named."""
ENDS = 2
"""Forms of the feeder whose J is shown: the first and the last."""
BALANCED_RESULT = 2
"""Column of the table of claims that the page leaves out, as it is in the reproduction."""
_ROWS = {"table_one": "Table I, all rows", "laws": "the laws at each number of sites"}


def render_comparison(records: Records) -> str:
    """Return the Markdown page for the records of :func:`compare_feeders`, with ``meta`` added to them."""
    parts = (_head, _causes, _claims, _orders, _table_one, _laws, _equipment)
    return "\n\n".join(part(records) for part in parts) + "\n"


def _head(records: Records) -> str:
    s, forms = records["setting"], records["cases"]
    purpose = (
        f"This page compares the study of {s['paper']}, on two models of its feeder: the balanced equivalent of "
        "[the reproduction](reproduction.md) and the unbalanced feeder with phases and regulators. It shows which "
        "conclusions depend on the balanced model."
    )
    setting = (
        f"{s['episodes']} episodes of 120 s for each cell, the same in every column, data centres {site_placement(s)}. "
        f"Load: **{s['load']}**, {s['load_description']}.{load_note(s)} The deviation is abs(V - 1) over all buses "
        "except the substation, or all their phases, and all seconds. Gains are those of the reproduction; nothing is "
        "tuned."
    )
    sites = "The seven inverters are at the same buses in all columns; four of these have one phase."
    if s["placement"] == "random":
        sites += (
            " On the unbalanced feeder data centres are at three-phase buses, while the equivalent also draws among "
            "single-phase laterals. `--placement published` uses the same buses for both."
        )
    columns = "\n".join(f"- *{form['label']}*: {form['about']}." for form in forms.values())
    parts = ("# The paper's study on the unbalanced feeder", wrapped(purpose), "Made by")
    parts += (code_block(records["meta"]["command"]), _summary(records))
    return "\n\n".join((*parts, "## Setting", wrapped(setting), wrapped(sites), columns))


def _summary(records: Records) -> str:
    """Summarise the gain and the verdicts on the first and the last form of the feeder."""
    first, *_, last = records["cases"].values()
    gain = next(list(row["values"].values()) for row in records["causes"] if row["figure"].startswith("gain"))
    changed = [
        (row["claim"], row["verdict"], there["verdict"])
        for row, there in zip(first["claims"], last["claims"], strict=True)
        if row["verdict"] != there["verdict"]
    ]
    taus = [
        order["kendall_tau"]
        for order in records["orders"]
        if (order["rows"], order["by"]) == ("laws", "J") and records["cases"][order["case"]] is last
    ]
    found = [
        f"The law's gain over inverters only is {gain[0]:.1f} % on the balanced equivalent and {gain[-1]:.1f} % on the "
        "unbalanced feeder with regulators.",
        f"The verdict differs on {len(changed)} of {len(first['claims'])} claims.",
        *(f"*{claim}*: *{verdict}* balanced, *{there}* unbalanced." for claim, verdict, there in changed),
    ]
    if taus[0] is not None:
        found.append(f"The ranking of the laws by J has a Kendall tau of {taus[0]:.2f} between the two models.")
    return "\n".join(wrapped(f"- {line}", "  ") for line in found)


def causes_table(records: Records) -> Table:
    """Split selected figures into the contributions of each form of the feeder."""
    forms = list(records["cases"].values())
    head = ["", forms[0]["label"], *(f"+ {form['label']}" for form in forms[1:]), "unbalanced feeder"]
    rows = []
    for row in records["causes"]:
        values, how = list(row["values"].values()), row["format"]
        signed = how if how.startswith("+") else f"+{how}"
        changes = [format(after - before, signed) for before, after in itertools.pairwise(values)]
        rows.append([row["figure"], format(values[0], how), *changes, format(values[-1], how)])
    return head, rows


def _causes(records: Records) -> str:
    return f"""## Causes of the differences

Means over 1 to 5 sites unless stated otherwise, k_p = 1. The first column of figures is the balanced equivalent, each
further column the contribution of that form, and the last column the sum.

{table(*causes_table(records))}"""


def table_one_table(records: Records) -> Table:
    """Table I on every form of the feeder: ranked deviations, then J, delay and spectral radius of the two ends."""
    forms = records["cases"]
    cells = {name: [r for r in form["table_one"] if r["memory"] == "cumulative"] for name, form in forms.items()}
    first = next(iter(cells.values()))
    head, columns = ["sites", "k_p (MW/p.u.)"], []
    columns += [_ranked([r["deviation_mean_pu"] for r in rows], ".4f") for rows in cells.values()]
    head += [f"deviation (p.u.): {form['label']}" for form in forms.values()]
    for name in (next(iter(forms)), list(forms)[-1]):
        columns.append(_ranked([r["J"] for r in cells[name]], ".3f"))
        columns.append([f"{r['delay_mean_s']:.2f}" for r in cells[name]])
        radius = {(r["n_datacenters"], r["k_p_mw_per_pu"]): r["spectral_radius"] for r in forms[name]["stability"]}
        columns.append([f"{radius[r['n_datacenters'], r['k_p_mw_per_pu']]:.2f}" for r in cells[name]])
        head += [f"{what}: {forms[name]['label']}" for what in ("J", "delay (s)", "spectral radius")]
    keys = [[str(r["n_datacenters"]), f"{r['k_p_mw_per_pu']:g}"] for r in first]
    return head, [[*key, *row] for key, row in zip(keys, zip(*columns, strict=True), strict=True)]


def _table_one(records: Records) -> str:
    return f"""## Table I

Cumulative backlog. Brackets contain the rank in the column, 1 for the lowest value.

{table(*table_one_table(records))}"""


def _ranked(values: list[float], how: str) -> list[str]:
    return [f"{value:{how}} ({place})" for value, place in zip(values, ranks(values), strict=True)]


def _laws(records: Records) -> str:
    forms = list(records["cases"].values())
    ends = (forms[0], forms[-1])
    rows = []
    for n in sorted({r["n_datacenters"] for r in forms[0]["comparison"]}):
        of_form = [[r for r in form["comparison"] if r["n_datacenters"] == n] for form in ends]
        columns = [_ranked([r["deviation_mean_pu"] for r in found], ".4f") for found in of_form]
        columns += [_ranked([r["J"] for r in found], ".3f") for found in of_form]
        laws = [LABELS[r["law"]] for r in of_form[0]]
        rows += [[str(n), law, *row] for law, row in zip(laws, zip(*columns, strict=True), strict=True)]
    head = ["sites", "law (k_p = 1)"]
    head += [f"{what}: {form['label']}" for what in ("deviation (p.u.)", "J") for form in ends]
    return f"""## No control, inverters only, both axes (Fig. 5)

Brackets contain the rank among the laws at that number of sites.

{table(head, rows)}"""


def orders_table(records: Records) -> Table:
    """Compare the ranking of the rows on each form of the feeder with that on the balanced one."""
    rows = []
    for order in records["orders"]:
        certain = [pair for pair in order["swapped"] if pair["certain"]]
        rows.append(
            [
                _ROWS[order["rows"]],
                order["by"],
                records["cases"][order["case"]]["label"],
                *("no order" if order[key] is None else f"{order[key]:.2f}" for key in ("kendall_tau", "spearman_rho")),
                f"{len(order['swapped'])} of {order['pairs']}",
                str(len(certain)),
                _named(certain),
            ]
        )
    head = ["rows", "ranked by", "compared with", "Kendall tau", "Spearman rho", "swapped pairs", "certain"]
    return [*head, "certain pairs"], rows


def _named(pairs: list[dict[str, Any]]) -> str:
    """Name swapped pairs, each once with its numbers of sites."""
    groups: dict[str, list[str]] = {}
    for pair in pairs:
        groups.setdefault(f"{pair['better']} before {pair['worse']}", []).append(pair["group"])
    named = [
        name + f" at {', '.join(where)} site{'s' * (where != ['1'])}" * any(where) for name, where in groups.items()
    ]
    more = [f"and {len(named) - SWAPS_SHOWN} more"] * (len(named) > SWAPS_SHOWN)
    return "; ".join([*named[:SWAPS_SHOWN], *more]) or "none"


def _orders(records: Records) -> str:
    return f"""## Ranking on the balanced equivalent

A pair of rows is swapped if the two feeders rank it differently. It is certain if the difference on both feeders
exceeds 0.1 % and twice its standard error over episodes. Pairs are in the order of the equivalent, rows of Table I as
(sites, k_p).

{table(*orders_table(records))}"""


def claims_table(records: Records) -> Table:
    """Return each claim on the balanced equivalent and the unbalanced feeder, with the verdicts on all forms."""
    forms = list(records["cases"].values())
    first, last, between = forms[0], forms[-1], forms[1:-1]
    head = ["claim", "paper", f"ours: {first['label']}", f"verdict: {first['label']}"]
    head += [f"ours: {last['label']}", f"verdict: {last['label']}"]
    head += [f"verdict: {form['label']}" for form in between] + [f"reason: {last['label']}"]
    rows = []
    for i, claim in enumerate(first["claims"]):
        there = last["claims"][i]
        cells = [claim["claim"], claim["paper"], claim["ours"], claim["verdict"], there["ours"], there["verdict"]]
        rows.append([*cells, *(form["claims"][i]["verdict"] for form in between), there["reason"]])
    return head, rows


def _claims(records: Records) -> str:
    left_out = "\n".join(wrapped(f"- *{claim}*: {why}.", "  ") for claim, why in LEFT_OUT.items())
    note = f"Claims that this study does not repeat:\n\n{left_out}"
    head, rows = claims_table(records)
    shown = [i for i in range(len(head)) if i != BALANCED_RESULT]
    text = "Results on the balanced equivalent are in [the reproduction](reproduction.md)."
    claims = table([head[i] for i in shown], [[row[i] for i in shown] for row in rows])
    return f"## Claims\n\n{text}\n\n{claims}\n\n{note}"


def _equipment(records: Records) -> str:
    columns = {
        "taps per episode": ("tap_moves", ".1f"),
        "unbalance, mean (%)": ("unbalance_mean_pct", ".2f"),
        "unbalance, largest (%)": ("unbalance_max_pct", ".2f"),
        "lowest V (p.u.)": ("voltage_min_pu", ".3f"),
        "highest V (p.u.)": ("voltage_max_pu", ".3f"),
    }
    rows: Iterable[list[str]] = (
        [records["cases"][row["case"]]["label"], LABELS[row["law"]]]
        + [format(row[key], how) for key, how in columns.values()]
        for row in records["equipment"]
    )
    return f"""## Regulators and unbalance

With five sites. Unbalance is the voltage unbalance factor over three-phase buses.

{table(("feeder", "law (k_p = 1)", *columns), rows)}"""
