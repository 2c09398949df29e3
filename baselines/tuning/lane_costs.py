"""Costs of episodes driven by a controller that may act otherwise in each lane, and of which nothing else is kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dcgrid_env import DcgridVectorEnv, Scenario
from dcgrid_env.baselines.controller import Controller


def lane_costs(scenario: Scenario, controller: Controller, seeds: Sequence[int]) -> np.ndarray:
    """J of an episode for each seed, (n_seed,); a record of long episodes of many lanes would not fit in memory."""
    env = DcgridVectorEnv(len(seeds), scenario.replace(reward="shared"))
    observations, _ = env.reset(seed=list(seeds))
    controller.reset(scenario)
    j, over = np.zeros(len(seeds)), np.zeros(len(seeds), dtype=bool)
    while not over.all():
        observations, _, terminated, truncated, _ = env.step(controller.act(observations))
        j += env.transition.cost_j * ~over
        over |= terminated | truncated
    env.close()
    return j / scenario.horizon
