"""How policies that know no feeder in advance do on feeders that they never saw: named ones, and many random ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dcgrid_env import RandomFeeders, Scenario, make_scenario
from dcgrid_env.agents import Evaluation, evaluate, find_controller
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.agents.studies.feeder_by_feeder import OnFeeder
from dcgrid_env.agents.studies.learning_tables import NONE, SCORE, Table, estimate, page, wrapped
from dcgrid_env.agents.studies.scored import score
from dcgrid_env.baselines import published
from dcgrid_env.baselines.carried import carried
from dcgrid_env.baselines.rollout import ControllerError
from dcgrid_env.baselines.score import REFERENCE
from dcgrid_env.baselines.user_code import OwnCodeError
from dcgrid_env.core.work.unit import Place, Unit


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
    """What the controller reaches, or why it refuses the scenario; errors of its own are raised."""
    on = make_scenario(asked.scenario, split=asked.split)
    try:
        with on_purpose():
            return evaluate(find_controller(asked.name, on), on, range(asked.episodes), asked.name)
    except ValueError as error:
        if isinstance(error, OwnCodeError) and not (isinstance(error, ControllerError) and error.refuses):
            raise  # it fails, which is no refusal
        return str(error)


def scores_table(results: Sequence[Tried], episodes: int) -> Table:
    """A row for each scenario, a score for each controller; J beside the droop's where hindsight is not known."""
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
    gained, possible = one.droop.J - own.J, one.droop.J - best.of(own.seeds).J
    return np.bincount(of, gained) / np.bincount(of, possible)


def _seeds(evaluation: Evaluation) -> np.ndarray:
    return np.array(evaluation.seeds, np.uint64)


def feeders_table(one: Tried, worst: int) -> Table | None:
    """How the scores of the feeders of a random family are spread, and the worst of them; None where there is none."""
    scores = {name: each for name in one.others if (each := feeder_scores(one, name)) is not None}
    return _spread(f"{one.scenario.name}: each random feeder by itself", scores, worst) if scores else None


def each_table(scenario: str, names: Sequence[str], driven: Sequence[OnFeeder], each: int, worst: int) -> Table:
    """How the scores over as many episodes of each feeder are spread, and the worst of them."""
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
