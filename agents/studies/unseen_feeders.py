"""How policies that know no feeder in advance do on feeders that they never saw: named ones, and many random ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dcgrid_env import RandomFeeders, Scenario, make_scenario
from dcgrid_env.agents import Evaluation, evaluate, find_controller
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.agents.studies.learning_tables import NONE, SCORE, Table, estimate, page, wrapped
from dcgrid_env.agents.studies.scored import score
from dcgrid_env.baselines import published
from dcgrid_env.baselines.rollout import ControllerError
from dcgrid_env.baselines.score import REFERENCE
from dcgrid_env.baselines.user_code import OwnCodeError


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


def tried(names: Sequence[str], scenario: str, split: str, episodes: int) -> Tried:
    """Drive a scenario's episodes 0, 1, .. of a split by controllers and by the tuned droop."""
    on, seeds = make_scenario(scenario, split=split), range(episodes)
    droop = evaluate(find_controller(REFERENCE, on), on, seeds, REFERENCE)
    others: dict[str, Evaluation | None] = {}
    refusals: dict[str, str] = {}
    for name in names:
        try:
            with on_purpose():
                others[name] = evaluate(find_controller(name, on), on, seeds, name)
        except ValueError as error:
            if isinstance(error, OwnCodeError) and not (isinstance(error, ControllerError) and error.refuses):
                raise  # it fails, which is no refusal
            others[name], refusals[name] = None, str(error)
    return Tried(on, droop, others, refusals)


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
    header = ("over the feeders", "mean", "median", "above 0", f"the worst {worst}")
    rows = []
    for name in one.others:
        each = feeder_scores(one, name)
        if each is not None:
            lowest = ", ".join(f"{value:.2f}" for value in np.sort(each)[:worst])
            rows.append((
                name, f"{each.mean():.3f}", f"{np.median(each):.3f}", f"{(each > 0).sum()} of {len(each)}", lowest
            ))  # fmt: skip
    return Table(f"{one.scenario.name}: each random feeder by itself", header, tuple(rows)) if rows else None


def markdown(shown: Table, of_feeders: Sequence[Table], made_by: str) -> str:
    """The page."""
    about = (
        "None of the scenarios was trained on, nor any variant of them. A controller of the scope model-aided is given "
        "the feeder's model and the places and ratings of all agents, as at commissioning, and then acts on what each "
        f"agent sees at its own bus. {NONE}: no hindsight is known. " + SCORE
    )
    tables = (table.markdown() for table in of_feeders)
    return page("Feeders that were never seen", made_by, wrapped(about), shown.markdown(), *tables)
