"""Scores of policies for any feeder on feeders outside their training: named ones and many random ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console

from dcgrid_env import RandomFeeders, Scenario, make_scenario
from dcgrid_env.agents import Evaluation, evaluate, find_controller
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import published
from dcgrid_env.baselines.carried import carried
from dcgrid_env.baselines.rollout import ControllerError
from dcgrid_env.baselines.scenario_names import scenario_names
from dcgrid_env.baselines.score import REFERENCE
from dcgrid_env.baselines.user_code import OwnCodeError
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import at_least, check_folder
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.files import write_text
from dcgrid_env.core.versions import meta
from dcgrid_env.core.work.unit import Place, Unit
from docs.studies.learning.feeder_by_feeder import OnFeeder, on_each_feeder
from docs.studies.learning.learning_tables import NONE, SCORE, Table, estimate, page, wrapped
from docs.studies.learning.scored import score
from docs.studies.learning.trainings import MOST_EPISODES


@dataclass(frozen=True)
class Tried:
    """Controllers on the episodes of one scenario and split."""

    scenario: Scenario
    droop: Evaluation
    others: dict[str, Evaluation | None]
    """By name; None where a controller refuses the scenario."""
    refusals: dict[str, str]
    """By name, what those say that refuse it."""


def require_found(names: Sequence[str], scenarios: Sequence[str], split: str) -> None:
    """ValueError for a split that there is not, and for a controller that is found for none of the scenarios."""
    made = [make_scenario(scenario, split=split) for scenario in scenarios]
    for name in names:
        errors = [error for on in made if (error := _not_found(name, on)) is not None]
        if len(errors) == len(made):
            raise errors[0]


def _not_found(name: str, on: Scenario) -> ValueError | None:
    try:
        find_controller(name, on)
    except ValueError as error:
        return error
    return None


class _Asked(NamedTuple):
    """A controller on the episodes 0, 1, .. of a scenario."""

    name: str
    scenario: str
    split: str
    episodes: int


def tried(names: Sequence[str], scenarios: Sequence[str], split: str, episodes: int, place: Place) -> Iterator[Tried]:
    """Drive each scenario's episodes 0, 1, .. of a split by controllers and by the tuned droop, as units of a place.

    LostUnits at the end where some have no result.
    """
    each = tuple(dict.fromkeys((REFERENCE, *names)))
    asked = [_Asked(name, scenario, split, episodes) for scenario in scenarios for name in each]
    units = [Unit(f"{one.name} on {one.scenario}", _driven, one) for one in asked]
    found: dict[_Asked, Evaluation | str] = {}
    left = list(scenarios)
    for unit, result in place.results(units, carried(place, (), names), how_to_go_on=""):
        found[unit.item] = result
        while left and all(_Asked(name, left[0], split, episodes) in found for name in each):
            scenario = left.pop(0)
            by_name = {name: found[_Asked(name, scenario, split, episodes)] for name in each}
            yield _tried(make_scenario(scenario, split=split), names, by_name)


def _tried(on: Scenario, names: Sequence[str], by_name: Mapping[str, Evaluation | str]) -> Tried:
    droop = by_name[REFERENCE]
    if isinstance(droop, str):
        raise ValueError(droop)
    # Each unit has made a scenario of its own, and evaluations are held against each other on one.
    ones = {name: replace(one, scenario=on) for name, one in by_name.items() if not isinstance(one, str)}
    return Tried(
        on,
        ones[REFERENCE],
        {name: ones.get(name) for name in names},
        {name: one for name in names if isinstance(one := by_name[name], str)},
    )


def _driven(asked: _Asked) -> Evaluation | str:
    """Evaluate the controller, or return why it refuses the scenario; raise its other errors."""
    on = make_scenario(asked.scenario, split=asked.split)
    try:
        with on_purpose():
            return evaluate(find_controller(asked.name, on), on, range(asked.episodes), asked.name)
    except ValueError as error:
        if isinstance(error, OwnCodeError) and not (isinstance(error, ControllerError) and error.refuses):
            raise  # it fails, which is no refusal
        return str(error)


def scores_table(results: Sequence[Tried], episodes: int) -> Table:
    """Return the table of scores by scenario and controller; it contains J if hindsight is not known."""
    names = list(results[0].others)
    rows = []
    for one in results:
        label = one.scenario.name if one.scenario.split == "test" else f"{one.scenario.name}, {one.scenario.split}"
        rows.append((label, *(_scored(one, name) for name in names), f"{one.droop.means['J']:.4f}"))
    title = f"{episodes} episodes of scenarios that were not trained on"
    return Table(title, ("scenario", *names, "J: droop-tuned"), tuple(rows))


def _scored(one: Tried, name: str) -> str:
    own = one.others[name]
    if own is None:
        return "does not apply"
    reached = score(own, one.droop)
    return f"J {own.means['J']:.4f}" if reached is None else estimate(reached)


def feeder_scores(one: Tried, name: str) -> np.ndarray | None:
    """Score on each random feeder, (n_feeder,), a ratio of sums over its episodes; None where there is none."""
    own, best = one.others[name], published(one.scenario)
    if own is None or best is None or not isinstance(one.scenario.feeder, RandomFeeders):
        return None
    _, of = np.unique(one.scenario.feeder.keys(one.scenario.split, _seeds(own), 0 * _seeds(own)), return_inverse=True)
    gained, possible = one.droop.J - own.J, one.droop.J - best.select(own.seeds).J
    return np.bincount(of, gained) / np.bincount(of, possible)


def _seeds(evaluation: Evaluation) -> np.ndarray:
    return np.array(evaluation.seeds, np.uint64)


def feeders_table(one: Tried, worst: int) -> Table | None:
    """Return the spread of the scores over the feeders of a random family, and the worst; None without scores."""
    scores = {name: each for name in one.others if (each := feeder_scores(one, name)) is not None}
    return _spread(f"{one.scenario.name}: each random feeder by itself", scores, worst) if scores else None


def each_table(scenario: str, names: Sequence[str], driven: Sequence[OnFeeder], each: int, worst: int) -> Table:
    """Return the spread of the scores of feeders with equally many episodes, and the worst of them."""
    scores = {name: np.array([on.score(name) for on in driven]) for name in names}
    return _spread(
        f"{scenario}: each random feeder by itself, {each} {'episode' if each == 1 else 'episodes'} of its own",
        scores,
        worst,
    )


def _spread(title: str, scores: Mapping[str, np.ndarray], worst: int) -> Table:
    header = ("over the feeders", "mean", "median", "above 0", f"the worst {worst}")
    rows = []
    for name, each in scores.items():
        lowest = ", ".join(f"{value:.2f}" for value in np.sort(each)[:worst])
        above = f"{(each > 0).sum()} of {len(each)}"
        rows.append((name, f"{each.mean():.3f}", f"{np.median(each):.3f}", above, lowest))
    return Table(title, header, tuple(rows))


def markdown(shown: Table, of_feeders: Sequence[Table], made_by: str) -> str:
    """The page."""
    about = (
        "None of the scenarios was trained on, nor any variant of them. A controller of the scope model-aided is given "
        "the feeder's model and the places and ratings of all agents, as at commissioning, and then acts on what each "
        f"agent sees at its own bus. {NONE}: no hindsight is known. " + SCORE
    )
    tables = (table.markdown() for table in of_feeders)
    return page("Feeders that were never seen", made_by, wrapped(about), shown.markdown(), *tables)


@dataclass(frozen=True)
class UnseenFeeders(OverWorkers):
    """Score controllers on feeders they never saw.

    Scores policies too, on named feeders and on each random one of zero-shot.
    """

    controllers: str = "model-aided"
    """Names of controllers, or files of policies, separated by commas."""
    scenarios: str = "ieee33,ieee123,das69,khodr141,ieee33-weak,mixed,toy6,sync,bursty,training,robust,zero-shot"
    """Names of scenarios, separated by commas (dcgrid list)."""
    split: str = "test"
    """Split of the episodes; those of --episodes have a score on test alone."""
    episodes: int = 100
    """Episodes: seeds 0, 1, ..; at least 2, at most the published 100."""
    each: int = 0
    """Episodes of each random feeder, with its own seeds 0, 1, .., for a separate table of scores. Their hindsight is
    solved too, about a second per episode. 0 omits the table."""
    worst: int = 5
    """How many of the worst random feeders to show."""
    out: Path | None = None
    """Folder for unseen-feeders.md; nothing is written unless given."""

    def run(self) -> None:
        """Drive, score, print. ValueError for an invalid setting, before anything is run."""
        names, scenarios = split_names(self.controllers), scenario_names(self.scenarios)
        if not names:
            raise ValueError("controllers is empty; name at least one")
        if not 2 <= self.episodes <= MOST_EPISODES:
            raise ValueError(f"episodes is {self.episodes}; give 2 to {MOST_EPISODES}, the published test episodes")
        at_least(self, worst=1, each=0)
        if self.out is not None:
            check_folder(self.out)
        require_found(names, scenarios, self.split)
        families = self._families(scenarios)
        place, console, results = self.place, plain_console(), []
        with progress_bar(console) as progress:
            bar = progress.add_task("scenarios", total=len(scenarios))
            for one in tried(names, scenarios, self.split, self.episodes, place):
                results.append(one)
                progress.advance(bar)
        shown = scores_table(results, self.episodes)
        of_feeders = [table for one in results if (table := feeders_table(one, self.worst)) is not None]
        for table in (shown, *of_feeders):
            console.print(table.rich(console.width))
        for line in (line for one in results for line in one.refusals.values()):
            say(console, line)
        for one in (one for one in results if one.scenario.name in families):
            if driving := [name for name in names if name not in one.refusals]:
                of_feeders.append(self._each(driving, one.scenario.name, place, console))
                console.print(of_feeders[-1].rich(console.width))
        if self.out is not None:
            write_text(self.out / "unseen-feeders.md", markdown(shown, of_feeders, meta()["command"]))
            say(console, f"wrote {self.out / 'unseen-feeders.md'}")

    def _families(self, scenarios: list[str]) -> list[str]:
        """Those whose feeders are driven one by one; ValueError where it is asked for and there are none."""
        if not self.each:
            return []
        families = [name for name in scenarios if isinstance(make_scenario(name).feeder, RandomFeeders)]
        if not families:
            raise ValueError(
                f"each is {self.each}; none of {', '.join(scenarios)} is on random feeders: name zero-shot"
            )
        return families

    def _each(self, names: list[str], family: str, place: Place, console: Console) -> Table:
        """Drive the feeders of a family one by one; the table of their scores."""
        with progress_bar(console) as progress:
            bar = progress.add_task("feeders", total=None)
            begun = lambda n: progress.update(bar, total=n)  # noqa: E731
            done = lambda: progress.advance(bar)  # noqa: E731
            driven = on_each_feeder(names, family, self.split, self.episodes, self.each, place, begun, done)
        return each_table(family, names, driven, self.each, self.worst)
