"""The benchmark's files: results.json, results.md and report.html."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dcgrid_env.apps.benchmark import report
from dcgrid_env.apps.benchmark.benchmark_figures import draw, score_figure
from dcgrid_env.apps.benchmark.benchmark_tables import LEGEND, saved_table, scenario_table, score_table
from dcgrid_env.apps.benchmark.gather import Results
from dcgrid_env.core.files import write_json, write_text
from dcgrid_env.core.html_page import png
from dcgrid_env.core.versions import code_block
from dcgrid_env.core.work.unit import Place, Unit


def write_results(out: Path, results: Sequence[Results], meta: Mapping[str, Any]) -> None:
    """results.json, with every episode, and results.md, with the tables."""
    summaries = [result.summary for result in results]
    rows = [row for summary in summaries for row in summary.rows]
    content = {
        "meta": dict(meta),
        "failures": [row.record() for row in rows if row.failure is not None],
        "summaries": [row.record() for row in rows if row.failure is None],
        "episodes": [
            record for result in results for row in result.summary.working for record in result.records[row.controller]
        ],
    }
    write_json(out / "results.json", content)
    tables = [score_table(summaries), saved_table(summaries), *map(scenario_table, summaries)]
    head = f"# dcgrid benchmark\n\n{code_block(meta['command'])}\n\n" + "\n\n".join(LEGEND) + "\n"
    write_text(out / "results.md", "\n".join([head, *(table.markdown() for table in tables)]))


def write_report(
    out: Path, results: Sequence[Results], place: Place, shared: Mapping[str, Any], meta: Mapping[str, Any]
) -> None:
    """report.html, its figures drawn as units of a place, with the values that they share."""
    summaries = [result.summary for result in results]
    sheets = [sheet for result in results if (sheet := result.sheet())]
    units = [Unit(f"figures of {sheet.summary.scenario}", draw, sheet) for sheet in sheets]
    drawn = {unit.item.summary.scenario: (unit.item.worst, figures) for unit, figures in place.run(units, shared)}
    sections = [report.Section(scenario_table(s), s.scenario, *drawn.get(s.scenario, (None, None))) for s in summaries]
    scores = score_figure(summaries)
    text = report.page(
        (score_table(summaries), saved_table(summaries)), png(scores) if scores else None, sections, meta
    )
    write_text(out / "report.html", text)
