"""The report: one HTML file that needs nothing else, its figures inside."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dcgrid_env.baselines.benchmark.benchmark_figures import Drawn, Replay
from dcgrid_env.baselines.benchmark.benchmark_tables import LEGEND, Table
from dcgrid_env.core.work.unit import Lost

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; margin: 2rem auto; max-width: 1180px; padding: 0 1rem }
h1 { font-size: 1.5rem } h2 { font-size: 1.2rem; margin-top: 2.5rem; border-top: 1px solid #ccc; padding-top: 1rem }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums }
th, td { padding: .2rem .6rem; text-align: right; border-bottom: 1px solid #e4e4e4 }
thead th { border-bottom: 2px solid #888; vertical-align: bottom } tbody th, th:first-child { text-align: left }
tbody th { font-weight: 600; white-space: nowrap } td { white-space: nowrap }
.wide { overflow-x: auto } img { max-width: 100%; height: auto } .note { color: #444; font-size: 13px; margin: .3rem 0 }
nav a { margin-right: .9rem }
""".strip()


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
    plot = _image(score_figure, "Scores with their intervals") if score_figure else ""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>dcgrid benchmark</title>'
        f"<style>{STYLE}</style></head><body>\n<h1>dcgrid benchmark</h1>\n<nav>{links}</nav>\n"
        f"{tables}\n{legend}\n{plot}\n"
        + "\n".join(map(_section, sections))
        + f"\n<h2>How it was made</h2>\n{_about(meta)}\n</body></html>\n"
    )


def _section(section: Section) -> str:
    parts = [f'<h2 id="{html.escape(section.name)}">{html.escape(section.table.title)}</h2>', section.table.html()]
    if isinstance(section.figures, Lost):
        parts.append(f"<p class=note>There are no figures: {html.escape(section.figures.reason)}</p>")
    elif section.figures and section.worst:
        parts.append(_image(section.figures.scenario, f"Voltage against delay and voltages on {section.name}"))
        parts += _replayed(section.name, section.worst, section.figures.worst)
    return "\n".join(parts)


def _replayed(name: str, worst: Replay, drawn: tuple[bytes, ...] | str) -> list[str]:
    """A heading for each of the worst episodes and its figure, or why there is none."""
    if isinstance(drawn, str):
        return [f"<p class=note>{html.escape(drawn)}</p>"]
    parts = []
    for seed, png in zip(worst.seeds, drawn, strict=True):
        whose = html.escape(" and of ".join(law for law, costliest in worst.costliest.items() if costliest == seed))
        parts.append(f"<p>The worst episode of {whose} (seed {seed}, where J is highest), replayed:</p>")
        parts.append(_image(png, f"Seed {seed} of {name}"))
    return parts


def _image(png: bytes, text: str) -> str:
    return f'<p><img alt="{html.escape(text)}" src="data:image/png;base64,{base64.b64encode(png).decode()}"></p>'


def _about(meta: Mapping[str, Any]) -> str:
    rows = [("command", meta["command"]), ("split and episodes", f"{meta['split']}, seeds 0 to {meta['episodes'] - 1}")]
    rows += [(name, str(version)) for name, version in meta["versions"].items()]
    rows += [(f"hash of {name}", digest) for name, digest in meta["scenarios"].items()]
    rows.append(("machine", ", ".join(f"{key} {value}" for key, value in meta["machine"].items())))
    return Table("", ("", ""), tuple(rows)).html()
