"""Policies of several training seeds on the test split: their mean with its interval, and how far they lie apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dcgrid_env import Scenario, make_scenario
from dcgrid_env.agents import Evaluation, Policy, evaluate, find_controller
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import Controller
from dcgrid_env.baselines.score import REFERENCE, SPLIT, Estimate


@dataclass(frozen=True)
class Scored:
    """One setting, trained with one or more seeds, or a controller."""

    mean: Evaluation
    """Costs of each episode and means of all metrics, averaged over the seeds."""
    each: tuple[Evaluation, ...]
    """Evaluation of each seed."""

    def score(self, droop: Evaluation) -> Estimate | None:
        """Return the score of the mean cost with its interval over episodes; None if the score is undefined."""
        return score(self.mean, droop)

    def spread(self, droop: Evaluation) -> tuple[float, float] | None:
        """Return the lowest and the highest score of a seed; None for a single seed or if the score is undefined."""
        scores = [score(one, droop) for one in self.each]
        values = [estimate.value for estimate in scores if estimate is not None]
        return (min(values), max(values)) if len(values) > 1 else None


def score(evaluation: Evaluation, droop: Evaluation) -> Estimate | None:
    """Score of an evaluation against the tuned droop's; None where hindsight's costs are not known."""
    try:
        return evaluation.score(droop).score
    except ValueError:
        return None


def on_test(scenario: str) -> Scenario:
    """A preset as policies are tested on it."""
    return make_scenario(scenario, split=SPLIT)


@lru_cache(maxsize=64)
def droop_on_test(scenario: str, episodes: int) -> Evaluation:
    """The tuned droop law on a preset's test episodes."""
    return controller_on_test(REFERENCE, scenario, episodes).mean


def controller_on_test(name: str, scenario: str, episodes: int) -> Scored:
    """A controller by its name on a preset's test episodes."""
    return scored([find_controller(name, on_test(scenario))], scenario, episodes)


def scored(controllers: Sequence[Controller | Policy], scenario: str, episodes: int) -> Scored:
    """Controllers, one for each training seed, on a preset's test episodes.

    Parameters
    ----------
    controllers
        At least one.
    scenario
        Name of a preset.
    episodes
        Seeds 0, 1, ..

    Raises
    ------
    ValueError
        Where one of them cannot drive the scenario.
    """
    test, seeds = on_test(scenario), range(episodes)
    evaluations = tuple(_evaluated(controller, test, seeds) for controller in controllers)
    means = {name: float(np.mean([one.means[name] for one in evaluations])) for name in evaluations[0].means}
    return Scored(Evaluation(test, tuple(seeds), np.mean([one.J for one in evaluations], axis=0), means), evaluations)


def _evaluated(controller: Controller | Policy, scenario: Scenario, seeds: Sequence[int]) -> Evaluation:
    """An evaluation with one more mean, ``J_but_delay``: J without the charges for work that waits."""
    with on_purpose():
        evaluation = evaluate(controller, scenario, seeds)
    waiting = evaluation.means["cost_backlog"] + evaluation.means["cost_leftover"]
    but_delay = {"J_but_delay": evaluation.means["J"] - waiting}
    return dataclasses.replace(evaluation, means=dict(evaluation.means) | but_delay)
