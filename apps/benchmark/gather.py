"""From units to a benchmark's results: what was done of each scenario, summed up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.apps.benchmark.benchmark_figures import Replay, Sheet
from dcgrid_env.apps.benchmark.jobs import V_EDGES_PU, Case, Unit
from dcgrid_env.apps.benchmark.summary import ScenarioSummary, summarise
from dcgrid_env.baselines.hindsight_costs import Published
from dcgrid_env.baselines.score import REFERENCE


@dataclass(frozen=True)
class Results:
    """One scenario's results."""

    case: Case
    summary: ScenarioSummary
    records: Mapping[str, Sequence[Mapping[str, Any]]]
    """Episodes of each controller that did not fail, in the order of their seeds."""
    voltages: Mapping[str, np.ndarray]
    """Counts in the bins of ``jobs.V_EDGES_PU``, of the same controllers."""

    def sheet(self) -> Sheet | None:
        """What to draw: of episodes the costliest of the best controller and the costliest of the reference, each under
        both; None where every controller failed.
        """
        rows = {row.controller: row.means or {} for row in self.summary.working}
        others = [name for name in rows if name != REFERENCE]
        if not rows:
            return None
        best = min(others, key=lambda name: rows[name]["J"]) if others else REFERENCE
        both = (best, REFERENCE) if others and REFERENCE in rows else (best,)
        costliest = {name: max(self.records[name], key=lambda record: record["J"])["seed"] for name in both}
        return Sheet(self.summary, self.voltages, Replay(self.case, costliest))


def gather(
    cases: Sequence[Case],
    controllers: Sequence[str],
    episodes: int,
    done: Mapping[Unit, Mapping[str, Any]],
    failures: Mapping[tuple[str, str], str],
    published: Callable[[Scenario], Published | None],
) -> list[Results]:
    """Results of each scenario.

    Parameters
    ----------
    cases, controllers, episodes
        What was planned: scenarios, names of controllers, and the number of episodes of each pair.
    done
        Records of the finished units; those of a pair that failed elsewhere are left out.
    failures
        Why a (scenario, controller) has no results.
    published
        Hindsight's figures for a scenario, None where there are none.
    """
    results = []
    for case in cases:
        name = case.scenario().name
        failed = {controller: text for (scenario, controller), text in failures.items() if scenario == name}
        units = sorted((u for u in done if u.scenario == name and u.controller not in failed), key=lambda u: u.first)
        records: dict[str, list[Mapping[str, Any]]] = {u.controller: [] for u in units}
        voltages = {u.controller: np.zeros(len(V_EDGES_PU) - 1, dtype=np.int64) for u in units}
        observes = {u.controller: done[u]["observes"] for u in units}
        for unit in units:
            records[unit.controller] += done[unit]["episodes"]
            first, counts = done[unit]["voltage"]["first_bin"], done[unit]["voltage"]["counts"]
            voltages[unit.controller][first : first + len(counts)] += counts
        hindsight, doubt = published(case.scenario()), no_hindsight(case, episodes, published)
        if hindsight is not None and doubt is None:
            hindsight = hindsight.select(range(episodes))
            try:
                hindsight.check_episodes(case.scenario(), episodes)
            except ValueError as error:
                doubt = str(error)
        summary = summarise(name, episodes, records, observes, failed, controllers, hindsight, doubt)
        results.append(Results(case, summary, records, voltages))
    return results


def no_hindsight(case: Case, episodes: int, published: Callable[[Scenario], Published | None]) -> str | None:
    """Why hindsight is missing for the episodes of a scenario and the command that solves them; None if it exists."""
    costs = published(case.scenario())
    missing = len(costs.missing(range(episodes))) if costs else episodes
    if not missing:
        return None
    command = f"dcgrid hindsight {case.spec.options('--scenarios')} --episodes {episodes}"
    return f"the hindsight cost is missing for {missing} of {episodes} episodes; compute it with `{command}`"
