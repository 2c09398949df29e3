"""Bundled policies on presets that they were not trained on, unchanged and under guard."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario, make_scenario
from dcgrid_env.agents import GuardedPolicy, Policy, evaluate, guarded
from dcgrid_env.agents.controllers import preset_of
from dcgrid_env.agents.policy.policy import SHIPPED
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import Published, make_controller, published
from dcgrid_env.baselines.rollout import ControllerError
from dcgrid_env.baselines.scenario_names import scenario_names
from dcgrid_env.baselines.score import REFERENCE, SPLIT
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import at_least, check_folder
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.files import write_text
from dcgrid_env.core.versions import meta
from docs.studies.learning.learning_tables import Table, page, wrapped

DOES_NOT_FIT = "-"
"""Cell of a policy whose networks do not fit a scenario's agents."""
LEAST = -0.5
"""Least acceptable score of a guarded policy on a preset that it was not trained on."""


class Cell(NamedTuple):
    """Scores of a policy on a scenario; both are None if its networks do not fit the agents."""

    plain: float | None
    """Score of the unchanged policy."""
    under_guard: float | None
    """Score under guard."""
    law_pct: float
    """Share of agents' steps in which the guard uses the law, %."""


@dataclass(frozen=True)
class Row:
    """Policies on a scenario."""

    scenario: str
    cells: dict[str, Cell]
    """By the policy's name."""


def policies_of(algorithm: str, scenarios: Sequence[str]) -> list[str]:
    """Policies of an algorithm that ship for these presets, in their order."""
    return [name for name in (f"{scenario}-{algorithm}" for scenario in scenarios) if name in SHIPPED]


def require_published(scenarios: Sequence[str], episodes: int, split: str) -> None:
    """ValueError for a split that there is not, a preset without hindsight, or more episodes than it has."""
    for name in scenarios:
        make_scenario(name, split=split)
        _hindsight(name, episodes if split == SPLIT else None)


def rows(policies: Sequence[str], scenarios: Sequence[str], episodes: int, split: str) -> Iterator[Row]:
    """Each scenario with the scores of all policies on it.

    On another split than the test split, where hindsight's costs are not published, the difference from the tuned droop
    is divided by the mean of what hindsight saves on the test split.
    """
    for name in scenarios:
        scenario, seeds = make_scenario(name, split=split), range(episodes)
        with on_purpose():
            possible = _possible(name, episodes if split == SPLIT else None)
            droop = evaluate(make_controller(REFERENCE, scenario), scenario, seeds).means["J"]
            cells = {policy: _cell(policy, scenario, seeds, droop, possible) for policy in policies}
        yield Row(name, cells)


def _hindsight(name: str, episodes: int | None) -> tuple[Scenario, Published, tuple[int, ...]]:
    """A preset on its test split, hindsight's costs, and the seeds of the episodes, all published ones for None."""
    test = make_scenario(name, split=SPLIT)
    costs = published(test)
    if costs is None:
        raise ValueError(f"scenario {name!r}: hindsight is not published for it; leave it out")
    seeds = tuple(costs.seeds if episodes is None else range(episodes))
    if missing := costs.missing(seeds):
        raise ValueError(f"episodes is {episodes}; {name} has {len(costs.seeds)}, not seed {missing[0]}: give fewer")
    return test, costs, seeds


def _possible(name: str, episodes: int | None) -> float:
    """Return the saving of hindsight over the tuned droop on a preset's test episodes; None: all published ones."""
    test, costs, seeds = _hindsight(name, episodes)
    return evaluate(make_controller(REFERENCE, test), test, seeds).means["J"] - float(np.mean(costs.select(seeds).J))


def _cell(policy: str, scenario: Scenario, seeds: range, droop: float, possible: float) -> Cell:
    found, law_pct = [], 0.0
    for controller in (Policy.load(policy), guarded(policy)):
        try:
            found.append((droop - evaluate(controller, scenario, seeds).means["J"]) / possible)
        except ControllerError as error:
            if not error.refuses:
                raise
            return Cell(None, None, 0.0)
        if isinstance(controller, GuardedPolicy):
            law_pct = float(np.mean([own["guard_law_pct"] for own in controller.episode_figures()]))
    return Cell(found[0], found[1], law_pct)


def made_for(policy: str, scenario: str) -> bool:
    """Whether a policy that ships was made for a preset."""
    return preset_of(policy) == scenario


def table(results: Sequence[Row], title: str, under_guard: bool) -> Table:
    """Scores, a row for each scenario and a column for each policy; its own is in brackets."""
    policies = list(results[0].cells)
    shown = []
    for row in results:
        cells = []
        for policy, cell in row.cells.items():
            score = cell.under_guard if under_guard else cell.plain
            text = DOES_NOT_FIT if score is None else f"{score:.2f}"
            cells.append(f"[{text}]" if made_for(policy, row.scenario) else text)
        shown.append((row.scenario, *cells))
    return Table(title, ("evaluated on", *(preset_of(policy) or policy for policy in policies)), tuple(shown))


def summary(results: Sequence[Row], title: str) -> Table:
    """Summarise the scores on other presets and on each policy's preset, unchanged and under guard."""
    apart = {home: [(cell, row.scenario, policy) for row in results for policy, cell in row.cells.items()
                    if cell.plain is not None and made_for(policy, row.scenario) == home]
             for home in (False, True)}  # fmt: skip
    lines = []
    for label, home in (("other presets", False), ("its training preset", True)):
        for how, at in (("unchanged", 0), ("under guard", 1)):
            scores = [(float(cell[at] or 0.0), scenario, policy) for cell, scenario, policy in apart[home]]
            if scores:
                values, (least, scenario, policy) = [one[0] for one in scores], min(scores)
                below = sum(value < LEAST for value in values)
                law = np.mean([cell.law_pct for cell, *_ in apart[home]]) if at else 0.0
                lines.append((label, how, str(len(values)), f"{np.mean(values):.3f}", f"{np.median(values):.3f}",
                              f"{least:.2f} ({policy} on {scenario})", str(below), f"{law:.0f}"))  # fmt: skip
    header = ("evaluated on", "policy", "pairs", "mean score", "median", "worst", f"below {LEAST:g}", "law in use, %")
    return Table(title, header, tuple(lines))


def markdown(parts: Sequence[tuple[str, Sequence[Row]]], episodes: int, split: str, made_by: str) -> str:
    """The page: for each algorithm the summary and both tables."""
    scale = "" if split == SPLIT else " Hindsight's costs are those of the test split and only set the scale."
    about = (
        f"Scores over {episodes} episodes of the {split} split: 0 is the tuned droop law, 1 perfect foresight. A row "
        "is the preset of the evaluation, a column the preset of the training. Brackets mark the pairs where both are "
        f"the same. {DOES_NOT_FIT} marks a policy whose networks do not fit the agents.{scale}"
    )
    text = [wrapped(about)]
    for algorithm, results in parts:
        text.append(summary(results, f"{algorithm}, all pairs").markdown())
        for how, under_guard in (("unchanged", False), ("under guard", True)):
            text.append(table(results, f"{algorithm}, {how}", under_guard).markdown())
    return page("Policies on other presets", made_by, *text)


BALANCED = "toy6,ieee123,ieee33-weak,ieee33,das69,khodr141,bursty,sync,training,mixed,fault,robust,scale-32"


@dataclass(frozen=True)
class Transfer(Command):
    """Score bundled policies on other presets.

    Each policy runs unchanged and under guard on presets that it was not trained on.
    """

    scenarios: str = BALANCED
    """Names of presets separated by commas, or all (dcgrid list)."""
    algorithms: str = "analytic"
    """Algorithms separated by commas; their bundled policies for these scenarios are run on all of them."""
    episodes: int = 20
    """Episodes of each pair: seeds 0, 1, ..; at least 2, on the test split at most the published 100."""
    split: str = "test"
    """Split of the episodes; on other splits than test, savings are a share of hindsight's savings on test."""
    out: Path = Path("results/transfer")
    """Folder for transfer.md."""

    def run(self) -> None:
        """Run all pairs, print, write. ValueError for an invalid setting, before anything is run."""
        scenarios, algorithms = scenario_names(self.scenarios), split_names(self.algorithms)
        at_least(self, episodes=2)
        policies = {name: policies_of(name, scenarios) for name in algorithms}
        if none := next((name for name, own in policies.items() if not own), None):
            raise ValueError(f"algorithms: no policy of {none!r} ships for these scenarios (dcgrid list)")
        require_published(scenarios, self.episodes, self.split)
        check_folder(self.out)
        console = plain_console()
        parts = []
        with progress_bar(console) as progress:
            bar = progress.add_task("scenarios", total=len(scenarios) * len(policies))
            for name, own in policies.items():
                results = []
                for row in rows(own, scenarios, self.episodes, self.split):
                    results.append(row)
                    progress.advance(bar)
                parts.append((name, results))
        for name, results in parts:
            console.print(summary(results, f"{name}, all pairs").rich(console.width))
        text = markdown(parts, self.episodes, self.split, meta()["command"])
        write_text(self.out / "transfer.md", text)
        say(console, f"wrote {self.out / 'transfer.md'}")
