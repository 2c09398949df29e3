"""Episodes of a scenario under a controller or a policy, and the score that they come to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines import Controller, Published, published, rollout
from dcgrid_env.baselines.controller import with_figures
from dcgrid_env.baselines.score import Score, score

_checked: WeakKeyDictionary[Scenario, set[tuple[str, ...]]] = WeakKeyDictionary()
"""Hashes of episodes that have been found to be the same here, so that many policies on them cost one check."""


@dataclass(frozen=True)
class Evaluation:
    """What a controller comes to on some episodes of a scenario."""

    scenario: Scenario
    seeds: tuple[int, ...]
    J: np.ndarray
    """Cost of each episode, (n_episode,), in the order of the seeds."""
    means: Mapping[str, float]
    """Mean over the episodes of each metric, and of figures of the controller (``controller.ReportsFigures``)."""

    def score(self, droop: Evaluation, hindsight: Published | None = None) -> Score:
        """Score against the tuned droop on the same episodes, and hindsight's costs of them.

        Parameters
        ----------
        droop
            What the tuned droop comes to on the same episodes.
        hindsight
            Costs of perfect foresight, ``published(scenario, folder)``; those that ship unless given.

        Raises
        ------
        ValueError
            Where there is no score, saying why: other episodes, no hindsight of exactly this scenario, split and seeds,
            or episodes that are drawn otherwise here than there.
        """
        if droop.seeds != self.seeds or droop.scenario != self.scenario:
            raise ValueError("no score: the droop was run on other episodes; evaluate both on the same")
        if len(self.seeds) < 2:
            raise ValueError("no score: an interval takes at least 2 episodes")
        return score(self.J, droop.J, hindsight_costs(self.scenario, self.seeds, hindsight))


def hindsight_costs(scenario: Scenario, seeds: Sequence[int], hindsight: Published | None = None) -> np.ndarray:
    """Hindsight's costs of these episodes, (n_episode,), once it is sure that they are the same here.

    ``hindsight`` is as in :meth:`Evaluation.score`, which says when this raises ValueError.
    """
    hindsight = hindsight or published(scenario)
    if hindsight is None:
        raise ValueError(
            f"no score: hindsight is published for the test split of the presets as they are, not for this "
            f"{scenario.name} ({scenario.split} split)"
        )
    if missing := hindsight.missing(seeds):
        n = len(hindsight.seeds)
        raise ValueError(f"no score: hindsight is published for {n} episodes, not for seed {missing[0]}")
    own = hindsight.of(seeds)
    if own.episode_hashes not in _checked.get(scenario, ()):
        own.check_episodes(scenario, len(seeds))
        _checked.setdefault(scenario, set()).add(own.episode_hashes)
    return own.J


def evaluate(controller: Controller, scenario: Scenario, seeds: Sequence[int], name: str | None = None) -> Evaluation:
    """Run a policy, or any controller, through the episodes of these seeds.

    Parameters
    ----------
    controller
        What drives the agents; a policy gets the scope of observation that it was trained with.
    scenario
        What to run; its split says which episodes the seeds mean.
    seeds
        One episode each, all at once as a batch.
    name
        What errors call the controller; its class by default.

    Raises
    ------
    ControllerError
        A ValueError, where the controller fails or cannot drive the scenario, saying what differs.
    """
    recorder = rollout(scenario, controller, seeds, name=name)
    metrics = with_figures(controller, recorder.metrics())
    means = {name: float(np.mean([m[name] for m in metrics])) for name in metrics[0]}
    return Evaluation(scenario, tuple(seeds), np.array([m["J"] for m in metrics]), means)
