"""What no control, the droop, the best constant and perfect foresight reach in a few episodes of a scenario."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from dcgrid_env import Recorder, Scenario
from dcgrid_env.baselines.laws import stability
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.laws.no_control import NoControl
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.model_based.trajectory import HindsightError
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.baselines.sanity.batch_search import fitted
from dcgrid_env.baselines.sanity.verdicts import (
    BARE,
    CONSTANT,
    DROOP,
    HINDSIGHT,
    NO_CONTROL,
    PAPER,
    PINNED,
    Figures,
    Reached,
    Verdict,
    verdicts,
)
from dcgrid_env.baselines.score import saved_pct
from dcgrid_env.core.text_table import Table
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Lost, Place, Unit

SECONDS = 40.0
_OF_HINDSIGHT, _OF_PINNED, _OF_DROOP = 0.55, 0.6, 0.75
"""Shares of the time after which these begin nothing further; the best constant is looked for until its end."""
_GAP = 1e-3
"""Gap between the replay and the program at which an episode of hindsight is near enough, as a share of J."""
_PINNED = 3
"""Episodes of hindsight at the top clock."""
_SLOW_S = 6.0
"""Time that an episode of hindsight takes from which it pays to start processes, s."""
_PLACEMENTS = 8
"""Placements that the droop's gain is looked at in, where a scenario draws them."""
_NEXT_TO_NOTHING_KW = 1e-3
_STEEP = 1e6
"""A reactive gain beyond every bound, from which the bound is read, Mvar per p.u. and s."""


@dataclass(frozen=True)
class ScenarioCheck:
    """What was reached, and what it says."""

    scenario: Scenario
    figures: Figures
    seconds: float
    """How long it took."""

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Conclusions from the figures, with a remedy where one is needed; the last one sums up."""
        return verdicts(self.scenario, self.figures)

    @property
    def is_worth_learning(self) -> bool:
        """Whether there is something to learn that simple rules do not do."""
        return not any(verdict.is_bar for verdict in self.verdicts)

    @property
    def table(self) -> Table:
        """Who reaches what, side by side."""
        from dcgrid_env import metrics_in

        reached = self.figures.reached
        shown = {name: reached[name] for name in (NO_CONTROL, PAPER, DROOP, CONSTANT, HINDSIGHT) if name in reached}
        rows = []
        for metric in metrics_in("check"):
            each = (metric.of_episodes(one.metrics[metric.name]) for one in shown.values())
            rows.append((metric.heading, *(metric.text(float(value)) for value in each)))
        droop = shown[DROOP].metrics["J"]
        saved = (saved_pct(one.metrics["J"], droop[: one.n]) for one in shown.values())
        rows.append(("J below that of the best droop, %", *(f"{share:.1f}" for share in saved)))
        rows.append(("episodes", *(str(one.n) for one in shown.values())))
        title = f"{self.scenario.name}, {self.scenario.split} split, found in {self.seconds:.0f} s"
        return Table(title, ("mean over episodes", *shown), tuple(rows))


def check_scenario(
    scenario: Scenario,
    episodes: int = 8,
    seconds: float = SECONDS,
    place: Place = ONE_PROCESS,
    on_stage: Callable[[str], None] = lambda _: None,
) -> ScenarioCheck:
    """Look whether a scenario is worth learning on.

    All are judged on the same episodes, those that hindsight has time for. The best constant and the best droop are
    fitted to them, so that what hindsight is ahead is there to be learned and no luck of a draw.

    Parameters
    ----------
    scenario
        With its split; the validation split leaves the test episodes alone.
    episodes
        How many: those of seeds 0, 1, ..
    seconds
        Time after which nothing further is begun; then all is of fewer episodes, one at the least.
    place
        Where episodes are solved that take long.
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
    on_stage(HINDSIGHT)
    refused = ""
    try:
        reached[HINDSIGHT] = _hindsight(scenario, seeds, began_s + _OF_HINDSIGHT * seconds, place)
        seeds = seeds[: reached[HINDSIGHT].n]
    except HindsightError as error:
        refused = str(error)
    has_clock, until_s = scenario.datacenters.count > 0, began_s + _OF_PINNED * seconds
    if HINDSIGHT in reached and has_clock and time.monotonic() < until_s:
        on_stage(PINNED)
        pinned = scenario.replace(datacenters={"f_min_mhz": scenario.datacenters.f_max_mhz})
        with contextlib.suppress(HindsightError):  # at full clocks there may be no solution
            reached[PINNED] = _hindsight(pinned, seeds[:_PINNED], until_s, place)
    on_stage(NO_CONTROL)
    recorder = rollout(scenario, NoControl(), seeds, name=NO_CONTROL)
    reached[NO_CONTROL], lowest_bus = Reached.from_metrics(recorder.metrics()), _lowest_bus(recorder, len(seeds))
    reached[PAPER] = Reached.from_metrics(rollout(scenario, Droop(), seeds, name=PAPER).metrics())
    on_stage(DROOP)
    reached[DROOP] = _fitted("droop", scenario, seeds, began_s + _OF_DROOP * seconds)
    on_stage(CONSTANT)
    reached[CONSTANT] = _fitted("constant-q", scenario, seeds, began_s + seconds)
    if scenario.datacenters.count:
        bare = scenario.replace(datacenters={"p_rated_kw": _NEXT_TO_NOTHING_KW})
        reached[BARE] = Reached.from_metrics(rollout(bare, NoControl(), seeds, name=BARE).metrics())
    bound = min(_largest_k_q(member) for member in {scenario.member(seed): None for seed in seeds})
    figures = Figures(reached, lowest_bus, refused, bound, episodes)
    return ScenarioCheck(scenario, figures, time.monotonic() - began_s)


def _largest_k_q(scenario: Scenario) -> float:
    """The largest reactive gain of the droop that is stable by itself, Mvar per p.u. and s."""
    steep = Droop(k_p_mw_per_pu=0.0, k_q_mvar_per_pu_s=_STEEP, alpha_per_s=0.0)
    return 2.0 * _STEEP / (stability.worst_radius(scenario, steep, _PLACEMENTS) + 1.0)


def _lowest_bus(recorder: Recorder, n_env: int) -> str:
    """The bus with the lowest voltage on average over an episode."""
    each = []
    for series in map(recorder.series, range(n_env)):
        feeder = series.scenario.feeder
        v_pu = series.v_pu[:, feeder.load_slice].mean(axis=0)
        node = np.arange(feeder.n_node)[feeder.load_slice][np.argmin(v_pu)]
        each.append((float(v_pu.min()), feeder.bus_ids[feeder.node_bus[node]]))
    return min(each)[1]


def _fitted(law: str, scenario: Scenario, seeds: Sequence[int], until_s: float) -> Reached:
    """Results of a law with the best parameters found for the episodes."""
    best = fitted(law, scenario, seeds, until_s)
    return Reached.from_metrics(rollout(scenario, best.controller, seeds, name=law).metrics(), best.parameters)


def _hindsight(scenario: Scenario, seeds: Sequence[int], until_s: float, place: Place) -> Reached:
    """Hindsight of the first of the episodes, and of as many more as there is time for."""
    began_s = time.monotonic()
    solved = {seeds[0]: _solved(scenario, seeds[0])}
    took_s = time.monotonic() - began_s
    place = place if took_s > _SLOW_S else ONE_PROCESS
    if time.monotonic() + took_s < until_s:
        units = [Unit(f"hindsight of seed {seed}", partial(_solved, scenario), seed) for seed in seeds[1:]]
        for unit, metrics in place.run(units):
            if not isinstance(metrics, Lost):
                solved[unit.item] = metrics
            if time.monotonic() + took_s > until_s:
                break
    n = next(i for i, seed in enumerate([*seeds, -1]) if seed not in solved)
    return Reached.from_metrics([solved[seed] for seed in seeds[:n]])


def _solved(scenario: Scenario, seed: int) -> dict[str, Any]:
    """Metrics of an episode under hindsight."""
    return hindsight(scenario, seed, tolerance=_GAP).recorder.metrics()[0]
