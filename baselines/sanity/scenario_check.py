"""What no control, the droop, the best constant and perfect foresight reach in a few episodes of a scenario."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines.benchmark.benchmark_tables import Table
from dcgrid_env.baselines.laws import stability
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.baselines.sanity.lane_search import fitted
from dcgrid_env.baselines.sanity.verdicts import Reached, Verdict, verdicts
from dcgrid_env.core.processes import Died, each

NONE, PAPER, DROOP, CONSTANT = "no control", "paper's droop", "best droop", "best constant"
HINDSIGHT, PINNED = "hindsight", "hindsight at the top clock"
ROWS = (
    "J", "voltage_deviation_mean_pu", "outside_bus_seconds_pct", "voltage_min_pu", "voltage_max_pu", "delay_mean_s",
)  # fmt: skip
"""Metrics of the table, column by column."""
OVER_EPISODES = {"mean": np.mean, "min": np.min, "max": np.max}
SECONDS = 40.0
_OF_RULES, _OF_HINDSIGHT = (0.2, 0.45), 0.85
"""Shares of the time after which the search of each rule, and hindsight, begin nothing further."""
_PINNED = 3
"""Episodes of hindsight at the top clock."""
_SLOW_S = 1.5
"""Time that an episode of hindsight takes from which it pays to start processes, s."""
_STEEP = 1e6
"""A reactive gain beyond every bound, from which the bound is read, Mvar per p.u. and s."""


@dataclass(frozen=True)
class ScenarioCheck:
    """What was reached, and what it says."""

    scenario: Scenario
    episodes: int
    reached: dict[str, Reached]
    """By name, in the order of the table. Hindsight may be of fewer episodes, the first ones."""
    refused: str
    """Why there is no hindsight; empty where there is."""
    largest_k_q: float
    """The largest reactive gain of the droop that is stable by itself, Mvar per p.u. and s."""
    seconds: float
    """How long it took."""

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What the figures say, each with a remedy where there is need of one; the last one sums up."""
        return verdicts(self.scenario, self.reached, self.refused, self.largest_k_q)

    @property
    def is_worth_learning(self) -> bool:
        """Whether there is something to learn that simple rules do not do."""
        return not any(verdict.is_bar for verdict in self.verdicts)

    @property
    def table(self) -> Table:
        """Who reaches what, one row each."""
        from dcgrid_env import METRICS

        metrics = [METRICS[name] for name in ROWS]
        rows = []
        for name, one in self.reached.items():
            cells = [m.text(float(OVER_EPISODES[m.over_episodes](one.metrics[m.name]))) for m in metrics]
            rows.append((name, str(one.n), *cells))
        title = f"{self.scenario.name}, {self.scenario.split} split, {self.seconds:.0f} s"
        return Table(title, ("", "episodes", *(m.heading for m in metrics)), tuple(rows))


def check_scenario(
    scenario: Scenario,
    episodes: int = 8,
    seconds: float = SECONDS,
    jobs: int = 1,
    on_stage: Callable[[str], None] = lambda _: None,
) -> ScenarioCheck:
    """Look whether a scenario is worth learning on.

    The best constant and the best droop are fitted to the very episodes that they are judged on, so that what hindsight
    is ahead of them is there to be learned and no luck of a draw.

    Parameters
    ----------
    scenario
        With its split; the validation split leaves the test episodes alone.
    episodes
        How many: those of seeds 0, 1, ..
    seconds
        Time after which nothing further is begun; then hindsight is of fewer episodes, one at the least.
    jobs
        Number of processes that solve episodes where these take long.
    on_stage
        Called with what is done next (for progress).

    Raises
    ------
    ValueError
        For fewer than one episode, or a time that is not above 0.
    """
    if episodes < 1 or not 0.0 < seconds < float("inf"):
        raise ValueError(f"episodes is {episodes} and seconds {seconds:g}; give at least 1 and more than 0")
    began_s, seeds = time.monotonic(), range(episodes)
    reached: dict[str, Reached] = {}
    for name, controller in ((NONE, NoControl()), (PAPER, Droop())):
        on_stage(name)
        reached[name] = Reached.of(rollout(scenario, controller, seeds, name=name).metrics())
    for name, law, share in zip((DROOP, CONSTANT), ("droop", "constant-q"), _OF_RULES, strict=True):
        on_stage(name)
        best = fitted(law, scenario, seeds, began_s + share * seconds)
        metrics = rollout(scenario, best.controller, seeds, name=name).metrics()
        reached[name] = Reached.of(metrics, best.parameters)
    on_stage(HINDSIGHT)
    refused = ""
    try:
        reached[HINDSIGHT] = _hindsight(scenario, seeds, began_s + _OF_HINDSIGHT * seconds, jobs)
    except ValueError as error:
        refused = str(error)
    has_clock = scenario.n_datacenters > 0 and scenario.f_min_mhz < scenario.f_max_mhz
    if HINDSIGHT in reached and has_clock and time.monotonic() < began_s + seconds:
        on_stage(PINNED)
        pinned = scenario.replace(f_min_mhz=scenario.f_max_mhz)
        reached[PINNED] = _hindsight(pinned, range(min(_PINNED, reached[HINDSIGHT].n)), began_s + seconds, jobs)
    steep = Droop(k_p_mw_per_pu=0.0, k_q_mvar_per_pu_s=_STEEP, alpha_per_s=0.0)
    bound = 2.0 * _STEEP / (stability.worst_radius(scenario, steep, min(episodes, 8)) + 1.0)
    return ScenarioCheck(scenario, episodes, reached, refused, bound, time.monotonic() - began_s)


def _hindsight(scenario: Scenario, seeds: Sequence[int], until_s: float, jobs: int) -> Reached:
    """Hindsight of the first of the episodes, and of as many more as there is time for."""
    began_s = time.monotonic()
    found = {seeds[0]: _solved(scenario, seeds[0])}
    took_s = time.monotonic() - began_s
    jobs = jobs if took_s > _SLOW_S else 1
    if time.monotonic() + took_s < until_s:
        for seed, metrics in each(partial(_solved, scenario), seeds[1:], jobs):
            if not isinstance(metrics, Died):
                found[seed] = metrics
            if time.monotonic() + took_s > until_s:
                break
    n = next(i for i, seed in enumerate([*seeds, -1]) if seed not in found)
    return Reached.of([found[seed] for seed in seeds[:n]])


def _solved(scenario: Scenario, seed: int) -> dict[str, Any]:
    """Metrics of an episode under hindsight."""
    return hindsight(scenario, seed).recorder.metrics()[0]
