"""The report: one HTML file that needs nothing else, its figures inside."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dcgrid_env.apps.benchmark.benchmark_figures import Drawn, Replay
from dcgrid_env.apps.benchmark.benchmark_tables import LEGEND
from dcgrid_env.core.html_page import image
from dcgrid_env.core.html_page import page as html_page
from dcgrid_env.core.text_table import Table
from dcgrid_env.core.work.unit import Lost

_STYLE = "tbody th { font-weight: 600; white-space: nowrap } td { white-space: nowrap }"


@dataclass(frozen=True)
class Section:
    """A scenario in the report."""

    table: Table
    name: str
    worst: Replay | None
    """The episodes that are replayed; None where every controller failed."""
    figures: Drawn | Lost | None
    """None likewise."""


def page(
    scores: Sequence[Table], score_figure: bytes | None, sections: Sequence[Section], meta: Mapping[str, Any]
) -> str:
    """The whole file."""
    links = "".join(f'<a href="#{html.escape(s.name)}">{html.escape(s.name)}</a>' for s in sections)
    legend = "".join(f"<p class=note>{html.escape(text)}</p>" for text in LEGEND)
    tables = "\n".join(f"<h2>{html.escape(table.title)}</h2>\n{table.html()}" for table in scores)
    plot = f"<p>{image(score_figure, 'Scores with their intervals')}</p>" if score_figure else ""
    body = [f"<nav>{links}</nav>", tables, legend, plot, *map(_section, sections)]
    return html_page("dcgrid benchmark", "\n".join([*body, "<h2>How it was made</h2>", _about(meta)]), _STYLE)


def _section(section: Section) -> str:
    parts = [f'<h2 id="{html.escape(section.name)}">{html.escape(section.table.title)}</h2>', section.table.html()]
    if isinstance(section.figures, Lost):
        parts.append(f"<p class=note>There are no figures: {html.escape(section.figures.reason)}</p>")
    elif section.figures and section.worst:
        picture = image(section.figures.scenario, f"Voltage against delay and voltages on {section.name}")
        parts.append(f"<p>{picture}</p>")
        parts += _replayed(section.name, section.worst, section.figures.worst)
    return "\n".join(parts)


def _replayed(name: str, worst: Replay, drawn: tuple[bytes, ...] | str) -> list[str]:
    """A heading for each of the worst episodes and its figure, or why there is none."""
    if isinstance(drawn, str):
        return [f"<p class=note>{html.escape(drawn)}</p>"]
    parts = []
    for seed, png in zip(worst.seeds, drawn, strict=True):
        laws = html.escape(" and of ".join(law for law, costliest in worst.costliest.items() if costliest == seed))
        parts.append(f"<p>The worst episode of {laws} (seed {seed}, where J is highest), replayed:</p>")
        parts.append(f"<p>{image(png, f'Seed {seed} of {name}')}</p>")
    return parts


def _about(meta: Mapping[str, Any]) -> str:
    rows = [("command", meta["command"]), ("split and episodes", f"{meta['split']}, seeds 0 to {meta['episodes'] - 1}")]
    rows += [(name, str(version)) for name, version in meta["versions"].items()]
    rows += [(f"hash of {name}", digest) for name, digest in meta["scenarios"].items()]
    rows.append(("machine", ", ".join(f"{key} {value}" for key, value in meta["machine"].items())))
    return Table("", ("", ""), tuple(rows)).html()
