"""What the episodes of a scenario under a controller come to, and its score."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.baselines import Published
from dcgrid_env.baselines.score import REFERENCE, Estimate, saved_pct, score


@dataclass(frozen=True)
class Summary:
    """One controller on one scenario; of one that failed there is only ``failure``."""

    scenario: str
    controller: str
    failure: str | None = None
    observes: str = ""
    means: Mapping[str, float] | None = None
    """Mean over the episodes of each metric of a record."""
    interquartile_mean: float | None = None
    """Mean of J over the middle half of the episodes; like the next three None where there are fewer than 2 episodes,
    and they also without a reference."""
    saved_pct: Estimate | None = None
    """Mean of J_reference - J in per cent of the mean of J_reference."""
    difference: Estimate | None = None
    """Mean of J - J_reference."""
    score: Estimate | None = None

    @property
    def applies(self) -> bool:
        """Whether the controller is made for such a scenario; one that failed there is."""
        return not (self.failure or "").startswith("does not apply")

    def record(self) -> dict[str, Any]:
        """The row as results.json holds it."""
        if self.failure is not None:
            return {"scenario": self.scenario, "controller": self.controller, "failure": self.failure}
        estimates = {"score": self.score, "saved_pct": self.saved_pct, "difference": self.difference}
        return {
            "scenario": self.scenario,
            "controller": self.controller,
            "observes": self.observes,
            **{name: estimate._asdict() if estimate else None for name, estimate in estimates.items()},
            "interquartile_mean": self.interquartile_mean,
            "means": dict(self.means or {}),
        }


class Hindsight(NamedTuple):
    """Perfect foresight over the episodes of a scenario."""

    J: float
    """Mean of what it reaches, replayed."""
    optimum: float
    """Mean of the linearised program's own optimum."""
    gap_pct: float
    """Largest distance of the two in an episode, in per cent of its J."""


class BestKnownCost(NamedTuple):
    """Replacement of hindsight's cost where no linear program describes the scenario; it is not a bound."""

    J: float
    """Mean of the least cost that is known of each episode."""


@dataclass(frozen=True)
class ScenarioSummary:
    """All controllers on one scenario."""

    scenario: str
    episodes: int
    rows: tuple[Summary, ...]
    no_score: str | None
    """Reason why scores are missing; None if they are known."""
    hindsight: Hindsight | BestKnownCost | None
    """None where it is not known for these episodes."""

    @property
    def working(self) -> list[Summary]:
        """Rows of the controllers that did not fail."""
        return [row for row in self.rows if row.failure is None]

    @property
    def headroom_pct(self) -> float | None:
        """Share of the reference's J that hindsight saves, %; None if either is unknown."""
        reference = next((row.means for row in self.working if row.controller == REFERENCE), None)
        return saved_pct(self.hindsight.J, reference["J"]) if reference and self.hindsight else None


def by_use(summaries: Sequence[ScenarioSummary]) -> tuple[list[str], list[str]]:
    """Controllers that apply to at least one of the scenarios, and the others, in the order of the rows."""
    applied = {row.controller for summary in summaries for row in summary.rows if row.applies}
    names = [row.controller for row in summaries[0].rows]
    return [name for name in names if name in applied], [name for name in names if name not in applied]


def hindsight_costs(costs: Published) -> Hindsight | BestKnownCost:
    """Mean costs of solved episodes."""
    if costs.is_best_known:
        return BestKnownCost(float(costs.J.mean()))
    gap_pct = 100.0 * float(np.abs((costs.J - costs.bound) / costs.J).max())
    return Hindsight(float(costs.J.mean()), float(costs.bound.mean()), gap_pct)


def summarise(
    scenario: str,
    episodes: int,
    records: Mapping[str, Sequence[Mapping[str, Any]]],
    observes: Mapping[str, str],
    failures: Mapping[str, str],
    order: Sequence[str],
    published: Published | None,
    doubt: str | None = None,
) -> ScenarioSummary:
    """Sum up a scenario.

    Parameters
    ----------
    scenario, episodes
        Its name, and how many episodes each controller was to have; their seeds are 0, 1, ...
    records, observes, failures
        By controller: its episodes in the order of their seeds and what it observes, or why there are none.
    order
        The controllers in the order of the rows.
    published
        Hindsight's figures for these episodes in the order of their seeds, None where there are none to be used.
    doubt
        Why there are none, None if there are.
    """
    droop = [r["J"] for r in records[REFERENCE]] if REFERENCE in records else None
    best = None if published is None or doubt else published.J
    missing = [] if droop else [f"{REFERENCE} {failures.get(REFERENCE, 'was not run')}"]
    missing += [doubt] if doubt else []
    why = "; ".join(missing) or _why_no_score(droop, best, episodes)
    reason = f"no score: {why}" if why else None
    rows = []
    for name in order:
        if name in failures:
            rows.append(Summary(scenario, name, failures[name]))
            continue
        of_controller = records[name]
        j = [r["J"] for r in of_controller]
        numbers = [
            key
            for key, value in of_controller[0].items()
            if not isinstance(value, str) and key not in ("episode", "seed")
        ]
        means = {key: float(np.mean([r[key] for r in of_controller])) for key in numbers}
        row = Summary(scenario, name, None, observes[name], means)
        if episodes > 1:
            # Difference and interquartile mean do not hang on what hindsight costs: anything below serves for them.
            against = j if droop is None else droop
            scored = score(j, against, np.subtract(against, 1.0) if reason or best is None else best)
            row = replace(
                row,
                interquartile_mean=scored.interquartile_mean,
                saved_pct=None if droop is None else scored.saved_pct,
                difference=None if droop is None else scored.difference,
                score=None if reason else scored.score,
            )
        rows.append(row)
    hindsight = None if published is None or best is None else hindsight_costs(published)
    return ScenarioSummary(scenario, episodes, tuple(rows), reason, hindsight)


def _why_no_score(droop: Sequence[float] | None, best: np.ndarray | None, episodes: int) -> str | None:
    if droop is None or best is None:
        return "hindsight is not known"
    if episodes < 2:
        return "an interval takes at least 2 episodes"
    if np.mean(droop - best) <= 0.0:
        return f"hindsight (J {best.mean():.4f}) does not beat {REFERENCE} (J {np.mean(droop):.4f})"
    return None
