"""Markdown tables that readers of the site sort and filter, by docs/static/tables.js."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from dcgrid_env.baselines.score import Estimate

NBSP = "\u00a0"
NONE = "–"
"""Cell without a value."""
NUMBER = re.compile(rf"-?\d|{NONE}|$")


def sortable(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose columns of figures are aligned to the right."""
    figures = [all(NUMBER.match(row[i]) for row in rows) for i in range(len(head))]
    ruled = "|".join("---:" if is_figure else "---" for is_figure in figures)
    lines = [_line(head), f"|{ruled}|", *map(_line, rows)]
    return "\n".join((":::{table}", ":class: sortable", "", *lines, ":::"))


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def with_interval(estimate: Estimate, decimals: int) -> str:
    """A figure and its interval, which stays on one line."""
    value, low, high = (number(figure, decimals) for figure in estimate)
    return f"{value} {unbroken(f'({low} to {high})')}"


def unbroken(text: str) -> str:
    """A text that stays on one line."""
    return text.replace(" ", NBSP)


def number(value: float, decimals: int) -> str:
    """A figure, without the sign of a zero."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def plain(text: str) -> str:
    """A text of others, which cannot break a table or add markup."""
    for sign in "\\|`*_[]$":
        text = text.replace(sign, f"\\{sign}")
    return text.replace("<", "&lt;").replace(">", "&gt;")
