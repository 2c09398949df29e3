"""Render the section on settings that come close to Table I."""

from __future__ import annotations

from typing import Any

from dcgrid_env.apps.reproduction.markdown_tables import table, wrapped
from dcgrid_env.apps.reproduction.paper import BUSES_INSIDE_PCT, FIVE_SITES_PU, GAIN_PCT, TABLE_ONE
from docs.studies.paper.guess import LABELS, VALUES

Records = dict[str, Any]


def render_guesses(records: Records) -> str:
    """Compare the guesses with the defaults: settings, distance from Table I, and figures that were not fitted."""
    columns: dict[str, Records] = records["guesses"]["columns"]
    text = (
        f"Table I depends on {len(VALUES)} settings that the paper does not state. `python -m docs.studies fit-paper` "
        "tried 231 choices of them. It minimised the mean absolute errors of deviation and delay, each as a share of "
        "its mean in the paper. An earlier search of the same size could also choose the rating of a site. It gave the "
        "last column, with sites of 560 kW instead of the stated 280 kW. Rows without *fitted* check the result."
    )
    settings = [
        [LABELS[name], *(_said(name, column["settings"][name]) for column in columns.values())] for name in LABELS
    ]
    checks: list[tuple[str, str, str, str]] = [
        ("fitted: mean error of the deviation (p.u.)", "0", "deviation_pu", ".4f"),
        ("fitted: mean error of the delay (s)", "0", "delay_s", ".2f"),
        ("mean error of the standard deviation (p.u.)", "0", "std_error_pu", ".4f"),
        ("mean gain over inverters only, 15 cells (%)", f"{GAIN_PCT:g}", "gain_pct", ".1f"),
        ("inverters only at 5 sites (p.u.)", f"{FIVE_SITES_PU[1]:g}", "inverters_five_pu", ".4f"),
        (
            "buses always inside the band, lowest cell (%)",
            f"over {BUSES_INSIDE_PCT:g}",
            "inside_least_pct",
            ".1f",
        ),
        ("buses always inside the band, mean of cells (%)", f"over {BUSES_INSIDE_PCT:g}", "inside_mean_pct", ".1f"),
    ]
    figures = [
        [label, paper, *(format(column[key], how) for column in columns.values())] for label, paper, key, how in checks
    ]
    put_back = [
        [LABELS[row["setting"]], f"{row['deviation_pu']:.4f}", f"{row['delay_s']:.2f}"]
        for row in records["guesses"]["put_back"]
    ]
    return f"""## Settings that come close to Table I

{wrapped(_conclusion(columns))}

{wrapped(text)}

{table(["setting", *columns], settings)}

{table(["figure", "paper", *columns], figures)}

The effect of each setting of the column *found*: the errors if that setting alone returns to its default.

{table(["setting", "error of the deviation (p.u.)", "error of the delay (s)"], put_back)}"""


def _conclusion(columns: dict[str, Records]) -> str:
    """Summarise the result of the search."""

    def rise(column: Records) -> float:
        cells = {(c["n_datacenters"], c["k_p"]): c["deviation_pu"] for c in column["cells"]}
        return cells[5, 1.0] - cells[1, 1.0]

    _, found, larger = columns.values()
    published = TABLE_ONE[5, 1.0].deviation_pu - TABLE_ONE[1, 1.0].deviation_pu
    either = ""
    if found["settings"]["squared"] != larger["settings"]["squared"]:
        either = " One uses V and the other V², so Table I does not decide between them."
    inside_pct = max(found["inside_mean_pct"], larger["inside_mean_pct"])
    return (
        f"Two sets of values come close to the table.{either} Neither reproduces the rest of the paper: on average at "
        f"most {inside_pct:.0f} % of the buses stay inside the band (paper over {BUSES_INSIDE_PCT:g} %). From 1 to "
        f"5 sites at k_p = 1 the deviation rises by {rise(found):.4f} and {rise(larger):.4f} p.u. (paper "
        f"{published:.3f}). {len(VALUES)} free settings for 30 numbers show how the table may have been made, not how "
        "it was made. The defaults stay: [decision 30](decisions/0030-paper-settings.md)."
    )


def _said(name: str, value: object) -> str:
    """Format the value of a setting."""
    if name == "squared":
        return "V²" if value else "V"
    if name == "capacitors":
        return "on" if value else "off"
    return value.replace("_", "-") if isinstance(value, str) else f"{value:g}"
