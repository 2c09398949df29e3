"""The written result of the study on several forms of the feeder: Markdown made of the records alone."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

from dcgrid_env.baselines.reproduction.drawing import LABELS
from dcgrid_env.baselines.reproduction.feeder_comparison import LEFT_OUT
from dcgrid_env.baselines.reproduction.markdown import load_note, table, where_sites_stand, wrapped
from dcgrid_env.baselines.reproduction.ranking import ranks
from dcgrid_env.core.versions import code_block

Records = dict[str, Any]
Table = tuple[list[str], list[list[str]]]
"""Headings and rows."""
SWAPS_SHOWN = 12
"""Swapped pairs that are named; more are counted."""
_ROWS = {"table_one": "Table I, all rows", "laws": "the laws at each number of sites"}


def render_comparison(records: Records) -> str:
    """Markdown of the records of :func:`compare_feeders`, to which ``meta`` has been added."""
    parts = (_head, _causes, _table_one, _laws, _orders, _claims, _equipment)
    return "\n\n".join(part(records) for part in parts) + "\n"


def _head(records: Records) -> str:
    s, forms = records["setting"], records["cases"]
    setting = (
        f"{s['episodes']} episodes of 120 s for each cell, the same in every column, data centres "
        f"{where_sites_stand(s)}. Load: **{s['load']}**, {s['load_description']}. "
        "Deviation is abs(V - 1) over all buses but the substation, or all their phases, and all seconds. k_p is the "
        "paper's, k_q = 0.5 Mvar/(p.u. s) and alpha = 0.3 /s are the defaults here; nothing is tuned, on neither "
        f"feeder.{load_note(s)}"
    )
    sites = (
        "On the feeder with its phases a data centre stands at a bus that has all three; the equivalent draws among "
        "its single-phase laterals too. `--placement published` puts both at the same buses. The seven inverters stand "
        "at the same buses in all columns, four of which have one phase."
        if s["placement"] == "random"
        else "The seven inverters stand at the same buses in all columns, four of which have one phase."
    )
    columns = "\n".join(f"- *{form['label']}*: {form['about']}." for form in forms.values())
    return "\n\n".join(
        (
            "# The paper's study on the unbalanced feeder",
            wrapped(f"{s['paper']}. The study on the balanced equivalent alone: [reproduction.md](reproduction.md)."),
            "Made by",
            code_block(records["meta"]["command"]),
            wrapped(setting),
            wrapped(sites),
            columns,
        )
    )


def causes_table(records: Records) -> Table:
    """What each form of the feeder adds to some figures."""
    forms = list(records["cases"].values())
    head = ["", forms[0]["label"], *(f"+ {form['label']}" for form in forms[1:]), "the true feeder"]
    rows = []
    for row in records["causes"]:
        values, how = list(row["values"].values()), row["format"]
        signed = how if how.startswith("+") else f"+{how}"
        changes = [format(after - before, signed) for before, after in itertools.pairwise(values)]
        rows.append([row["figure"], format(values[0], how), *changes, format(values[-1], how)])
    return head, rows


def _causes(records: Records) -> str:
    return f"""## What changes, and what it is due to

Means over 1 to 5 sites unless a row says otherwise, k_p = 1. The first column of figures is the balanced equivalent,
each further one what that form adds, the last one their sum.

{table(*causes_table(records))}"""


def table_one_table(records: Records) -> Table:
    """Table I on every form of the feeder: the deviations with their places, then J, delay and spectral radius."""
    forms = records["cases"]
    cells = {name: [r for r in form["table_one"] if r["memory"] == "cumulative"] for name, form in forms.items()}
    first = next(iter(cells.values()))
    head, columns = ["sites", "k_p (MW/p.u.)"], []
    for key, what, how in (("deviation_mean_pu", "deviation (p.u.)", ".4f"), ("J", "J", ".3f")):
        columns += [_ranked([r[key] for r in rows], how) for rows in cells.values()]
        head += [f"{what}: {form['label']}" for form in forms.values()]
    ends = (next(iter(forms)), list(forms)[-1])
    for name in ends:
        columns.append([f"{r['delay_mean_s']:.2f}" for r in cells[name]])
        radius = {(r["n_datacenters"], r["k_p_mw_per_pu"]): r["spectral_radius"] for r in forms[name]["stability"]}
        columns.append([f"{radius[r['n_datacenters'], r['k_p_mw_per_pu']]:.2f}" for r in cells[name]])
        head += [f"{what}: {forms[name]['label']}" for what in ("delay (s)", "spectral radius")]
    keys = [[str(r["n_datacenters"]), f"{r['k_p_mw_per_pu']:g}"] for r in first]
    return head, [[*key, *row] for key, row in zip(keys, zip(*columns, strict=True), strict=True)]


def _table_one(records: Records) -> str:
    return f"""## Table I

With the cumulative backlog; in brackets the place among the rows of the column, 1 the lowest.

{table(*table_one_table(records))}"""


def _ranked(values: list[float], how: str) -> list[str]:
    return [f"{value:{how}} ({place})" for value, place in zip(values, ranks(values), strict=True)]


def _laws(records: Records) -> str:
    forms = records["cases"]
    rows = []
    counts = sorted({r["n_datacenters"] for r in next(iter(forms.values()))["comparison"]})
    for n in counts:
        of_form = [[r for r in form["comparison"] if r["n_datacenters"] == n] for form in forms.values()]
        columns = [_ranked([r["deviation_mean_pu"] for r in own], ".4f") for own in of_form]
        columns += [_ranked([r["J"] for r in own], ".3f") for own in of_form]
        laws = [LABELS[r["law"]] for r in of_form[0]]
        rows += [[str(n), law, *row] for law, row in zip(laws, zip(*columns, strict=True), strict=True)]
    head = ["sites", "law (k_p = 1)"]
    head += [f"{what}: {form['label']}" for what in ("deviation (p.u.)", "J") for form in forms.values()]
    return f"""## No control, inverters only, both (Fig. 5)

In brackets the place among the laws at that number of sites.

{table(head, rows)}"""


def orders_table(records: Records) -> Table:
    """How far each form of the feeder ranks the rows as the balanced one does, and which pairs it does not."""
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
                _named([pair for pair in order["swapped"] if not pair["certain"]]),
            ]
        )
    head = ["rows", "ranked by", "balanced against", "Kendall tau", "Spearman rho", "swapped pairs", "certain"]
    return [*head, "which are certain", "which are not"], rows


def _named(pairs: list[dict[str, Any]]) -> str:
    """Swapped pairs by name, those that more than one group has once, with the numbers of sites."""
    groups: dict[str, list[str]] = {}
    for pair in pairs:
        groups.setdefault(f"{pair['better']} before {pair['worse']}", []).append(pair["group"])
    named = [
        name + f" at {', '.join(where)} site{'s' * (where != ['1'])}" * any(where) for name, where in groups.items()
    ]
    more = [f"and {len(named) - SWAPS_SHOWN} more"] * (len(named) > SWAPS_SHOWN)
    return "; ".join([*named[:SWAPS_SHOWN], *more]) or "none"


def _orders(records: Records) -> str:
    return f"""## Is the equivalent's ranking right?

A pair of rows is swapped where the equivalent says that the first is better and the other feeder the second; it is
certain where the difference is beyond twice its standard error over episodes, and beyond 0.1 %, on both. Pairs are
named in the order in which the equivalent has them, rows of Table I as (sites, k_p).

{table(*orders_table(records))}"""


def claims_table(records: Records) -> Table:
    """Each claim on the balanced equivalent and on the true feeder, then the verdicts in between and the reason."""
    forms = list(records["cases"].values())
    first, last, between = forms[0], forms[-1], forms[1:-1]
    head = ["claim", "paper", f"ours: {first['label']}", "verdict", f"ours: {last['label']}", "verdict"]
    head += [f"verdict: {form['label']}" for form in between] + [f"why: {last['label']}"]
    rows = []
    for i, claim in enumerate(first["claims"]):
        there = last["claims"][i]
        cells = [claim["claim"], claim["paper"], claim["ours"], claim["verdict"], there["ours"], there["verdict"]]
        rows.append([*cells, *(form["claims"][i]["verdict"] for form in between), there["reason"]])
    return head, rows


def _claims(records: Records) -> str:
    left_out = "\n".join(wrapped(f"- *{claim}*: {why}.") for claim, why in LEFT_OUT.items())
    note = f"Claims that this page leaves out:\n\n{left_out}"
    return f"## Claims\n\n{table(*claims_table(records))}\n\n{note}"


def _equipment(records: Records) -> str:
    columns = {
        "taps made in an episode": ("tap_moves", ".1f"),
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
