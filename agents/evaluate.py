"""Episodes of a scenario under a controller or a policy, and the score that they come to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.baselines import Controller, published, rollout
from dcgrid_env.baselines.score import Score, score

REFERENCE = "droop-tuned"
"""The controller of score 0."""
STATIC = ("constant-q-tuned", "placement-tuned")
"""Rules that measure nothing: the least that a policy must beat."""


@dataclass(frozen=True)
class Evaluation:
    """What a controller comes to on some episodes of a scenario."""

    scenario: Scenario
    seeds: tuple[int, ...]
    J: np.ndarray
    """Cost of each episode, (n_episode,), in the order of the seeds."""
    means: Mapping[str, float]
    """Mean over the episodes of each metric."""

    def score(self, droop: Evaluation) -> Score:
        """Score against the tuned droop on the same episodes and the hindsight published for them.

        ValueError, saying why, where there is none: other episodes, no hindsight published for exactly this scenario,
        split and seeds, or episodes that are drawn otherwise here than there.
        """
        if droop.seeds != self.seeds or droop.scenario != self.scenario:
            raise ValueError("no score: the droop was run on other episodes; evaluate both on the same")
        if len(self.seeds) < 2:
            raise ValueError("no score: an interval takes at least 2 episodes")
        return score(self.J, droop.J, _hindsight(self.scenario, self.seeds))


@lru_cache(maxsize=64)
def _hindsight(scenario: Scenario, seeds: tuple[int, ...]) -> np.ndarray:
    """Published costs of these episodes, (n_episode,), once it is sure that they are the same here."""
    known = published(scenario)
    if known is None:
        raise ValueError(
            f"no score: hindsight is published for the test split of the presets as they are, not for this "
            f"{scenario.name} ({scenario.split} split)"
        )
    at = {int(seed): i for i, seed in enumerate(known.seeds)}
    missing = [seed for seed in seeds if seed not in at]
    if missing:
        raise ValueError(f"no score: hindsight is published for {len(at)} episodes, not for seed {missing[0]}")
    index = [at[seed] for seed in seeds]
    known.check_episodes(scenario, max(index) + 1)
    return known.J[index]


def evaluate(controller: Controller, scenario: Scenario, seeds: Sequence[int]) -> Evaluation:
    """Run a policy, or any controller, through the episodes of these seeds.

    Parameters
    ----------
    controller
        What drives the agents; a policy gets the scope of observation that it was trained with.
    scenario
        What to run; its split says which episodes the seeds mean.
    seeds
        One episode each, all at once as a batch.

    Raises
    ------
    ValueError
        Where the controller cannot drive the scenario; a ``PolicyError`` from a policy, saying what differs.
    """
    recorder = rollout(scenario, controller, seeds)
    metrics = recorder.metrics()
    means = {name: float(np.mean([m[name] for m in metrics])) for name in metrics[0]}
    return Evaluation(scenario, tuple(seeds), np.array([m["J"] for m in metrics]), means)
