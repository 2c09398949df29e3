"""Columns, cells and page layout that the tables of these studies share."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

from dcgrid_env import METRICS, Metric
from dcgrid_env.apps.reproduction.markdown_tables import wrapped
from dcgrid_env.baselines.score import Estimate
from dcgrid_env.core.text_table import NONE, Table
from dcgrid_env.core.versions import code_block

COLUMNS = (
    METRICS["J"],
    dataclasses.replace(METRICS["voltage_deviation_mean_pu"], decimals=5),  # variants differ by little
    METRICS["outside_bus_seconds_pct"],
    METRICS["cost_violation"],
    Metric("J_but_delay", "J without delay", "", 4, "lower"),
    METRICS["delay_mean_s"],
)
"""Columns that are means over episodes."""
HEADINGS = tuple(metric.column for metric in COLUMNS)
SCORE = (
    "Score: 0 is the tuned droop law, 1 perfect foresight; mean(J_droop - J) / mean(J_droop - J_hindsight) over the "
    "test episodes, with its 95 % paired bootstrap interval over episodes. Several training seeds enter with their "
    "mean cost."
)


def figures(means: Mapping[str, float]) -> tuple[str, ...]:
    """Cells under ``HEADINGS``."""
    return tuple(metric.text(means[metric.name]) for metric in COLUMNS)


def estimate(value: Estimate | None, decimals: int = 3) -> str:
    """A score with its interval."""
    if value is None:
        return NONE
    return f"{value.value:.{decimals}f} ({value.low:.{decimals}f} to {value.high:.{decimals}f})"


def spread(value: tuple[float, float] | None) -> str:
    """Lowest and highest of the seeds."""
    return NONE if value is None else f"{value[0]:.3f} to {value[1]:.3f}"


def brief(table: Table, *headings: str) -> Table:
    """A table for the terminal: the first column and those named, without intervals and notes."""
    at = [0, *(table.header.index(heading) for heading in headings)]
    rows = tuple(tuple(row[i].partition(" (")[0] if i else row[i] for i in at) for row in table.rows)
    return Table(table.title, tuple(table.header[i] for i in at), rows)


def page(title: str, made_by: str, *parts: str) -> str:
    """A page of Markdown with the command that makes it."""
    return (
        "\n\n".join((f"# {title}", f"Made by\n\n{code_block(made_by)}", *(part.strip("\n") for part in parts if part)))
        + "\n"
    )


def commands(about: str, each: Iterable[tuple[str, str]]) -> str:
    """Commands under what each is for."""
    lines = [f"# {label}\n{command}" for label, command in each]
    return f"{about}\n\n```bash\n" + "\n".join(lines) + "\n```"


__all__ = [
    "HEADINGS",
    "NONE",
    "SCORE",
    "Table",
    "brief",
    "commands",
    "estimate",
    "figures",
    "page",
    "spread",
    "wrapped",
]
