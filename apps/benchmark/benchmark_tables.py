"""The benchmark's tables: the score of every controller on every scenario, and all other figures for each scenario."""

from __future__ import annotations

from collections.abc import Sequence

from dcgrid_env import METRICS, metrics_in
from dcgrid_env.apps.benchmark.summary import BestKnownCost, ScenarioSummary, Summary, by_use
from dcgrid_env.baselines.score import IS_NO_BOUND, REFERENCE, SAVED, Estimate
from dcgrid_env.core.text_table import NONE, Table

COLUMNS = metrics_in("benchmark")
"""Columns that are means over episodes."""

LEGEND = (
    f"Score: mean(J_ref - J) / mean(J_ref - J_hindsight) over the same test episodes; 0 is {REFERENCE}, 1 is perfect "
    "foresight. Where a table has a best known cost, this cost replaces J_hindsight. 95 % intervals over episodes are "
    "in parentheses.",
    f"J saved: mean(J_ref - J) / mean(J_ref), in per cent of the cost of {REFERENCE}. The headroom is the share "
    "that hindsight saves. If the headroom is small, even a score of 1 saves little.",
    "J is the benchmark's cost, lower is better; IQM is the mean over the middle half of the episodes. The "
    "columns for voltage, violation, delay, unserved work and effort show whether a better voltage is paid for with "
    "delay.",
    "observes: the scope of observation; a controller with the feeder's model also receives the buses of the agents.",
)


def score_table(summaries: Sequence[ScenarioSummary], interval: bool = True) -> Table:
    """Scores of all controllers (rows) on all scenarios (columns)."""
    names, left_out = by_use(summaries)
    by_name = {(s.scenario, row.controller): row for s in summaries for row in s.rows}
    rows = [(name, *(_score_cell(by_name[s.scenario, name], interval) for s in summaries)) for name in names]
    reasons: dict[str, list[str]] = {}
    for s in summaries:
        if s.no_score:
            reasons.setdefault(s.no_score, []).append(s.scenario)
    notes = [f"{', '.join(scenarios)}: {reason}" for reason, scenarios in reasons.items()]
    if left_out:
        which = "this scenario" if len(summaries) == 1 else "any of these scenarios"
        notes.append(f"Not in the table, because they do not apply to {which}: {', '.join(left_out)}.")
    return Table("Score", ("controller", *(s.scenario for s in summaries)), tuple(rows), tuple(notes))


def saved_table(summaries: Sequence[ScenarioSummary]) -> Table:
    """How much of the reference's J all controllers, and hindsight, save on all scenarios, %."""
    names, _ = by_use(summaries)
    by_name = {(s.scenario, row.controller): row.saved_pct for s in summaries for row in s.rows}
    rows = [(name, *(_estimate(by_name[s.scenario, name], ".1f") for s in summaries)) for name in names]
    rows.append(("hindsight (headroom)", *(_number(s.headroom_pct) for s in summaries)))
    title = f"J saved, % of J of {REFERENCE}"
    return Table(title, ("controller", *(s.scenario for s in summaries)), tuple(rows))


def scenario_table(summary: ScenarioSummary) -> Table:
    """Everything about one scenario."""
    header = ("controller", "score", SAVED, "J", "IQM of J", *(metric.column for metric in COLUMNS), "observes")
    rows = [row for row in summary.rows if row.applies]
    notes = [f"{row.controller}: {row.failure}" for row in rows if row.failure]
    if left_out := by_use([summary])[1]:
        which = f"Not in the table, because they do not apply to this scenario: {', '.join(left_out)}."
        notes.append(f"{which} Their reasons are in results.json.")
    saves = "" if summary.headroom_pct is None else f", {summary.headroom_pct:.1f} % of J saved"
    if isinstance(summary.hindsight, BestKnownCost):
        notes.insert(0, f"Best known: J {summary.hindsight.J:.4f}{saves}. {IS_NO_BOUND}")
    elif summary.hindsight:
        j, optimum, gap_pct = summary.hindsight
        notes.insert(
            0,
            f"Hindsight: J {j:.4f}{saves}; the linearised program's own optimum {optimum:.4f} (largest gap of an "
            f"episode {gap_pct:.2f} % of J).",
        )
    if summary.no_score:
        notes.insert(0, summary.no_score[0].upper() + summary.no_score[1:] + ".")
    title = f"{summary.scenario}: {summary.episodes} test episodes, means over episodes"
    return Table(title, header, tuple(map(_figures, rows)), tuple(notes))


def _figures(row: Summary) -> tuple[str, ...]:
    if row.means is None:
        blank = [NONE] * (len(COLUMNS) + 4)
        return (row.controller, _score_cell(row, True), *blank)
    iqm = NONE if row.interquartile_mean is None else f"{row.interquartile_mean:.4f}"
    cells = (metric.text(row.means[metric.name]) for metric in COLUMNS)
    return (
        row.controller,
        _score_cell(row, True),
        _estimate(row.saved_pct, ".1f"),
        METRICS["J"].text(row.means["J"]),
        iqm,
        *cells,
        row.observes,
    )


def _score_cell(row: Summary, interval: bool) -> str:
    if row.failure is not None:
        return "failed" if row.applies else "does not apply"
    if row.score is not None and not interval:
        return f"{row.score.value:.3f}"
    return _estimate(row.score, ".3f")


def _estimate(estimate: Estimate | None, form: str) -> str:
    if estimate is None:
        return NONE
    return f"{estimate.value:{form}} ({estimate.low:{form}} to {estimate.high:{form}})"


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.1f}"
