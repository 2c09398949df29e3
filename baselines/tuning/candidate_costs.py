"""Costs of a law with many sets of parameters, whose episodes run in one batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dcgrid_env import DcgridVectorEnv, Scenario
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.tuning.tunable import Parameters, Tunable


def episode_costs(scenario: Scenario, controller: Controller, seeds: Sequence[int]) -> np.ndarray:
    """J of an episode for each seed, (n_seed,); a record of many long episodes would not fit in memory."""
    env = DcgridVectorEnv(len(seeds), scenario.replace(reward="shared"), info="none")
    observations, _ = env.reset(seed=list(seeds))
    controller.reset(scenario)
    j, over = np.zeros(len(seeds)), np.zeros(len(seeds), dtype=bool)
    while not over.all():
        observations, _, terminated, truncated, _ = env.step(controller.act(observations))
        j += env.transition.cost_j * ~over
        over |= terminated | truncated
    env.close()
    return j / scenario.horizon


def mean_costs(law: Tunable, scenario: Scenario, sets: Sequence[Parameters], seeds: Sequence[int]) -> np.ndarray:
    """Mean J over the episodes with each set of parameters, (n_set,).

    The parameters are numbers, tuples of one for each agent, or mappings to numbers. The law's fields become arrays
    with a row for each environment. Sets that need other fields of the scenario (``Tunable.overrides``) run one after
    the other.
    """
    if law.overrides(scenario, sets[0]):
        changed = (scenario.replace(**law.overrides(scenario, parameters)) for parameters in sets)
        pairs = zip(changed, (law.law(**parameters) for parameters in sets), strict=True)
        return np.array([episode_costs(other, controller, seeds).mean() for other, controller in pairs])
    controller = law.law()
    for field in sets[0]:
        setattr(controller, field, _by_env([parameters[field] for parameters in sets], len(seeds)))
    costs = episode_costs(scenario, controller, list(seeds) * len(sets))
    return costs.reshape(len(sets), len(seeds)).mean(axis=1)


def _by_env(values: Sequence[Any], n_seed: int) -> Any:
    """Return a field of the sets by environment: (row, 1) or (row, n_agent), and (row,) in a mapping."""
    if isinstance(values[0], Mapping):
        return {name: np.repeat([value[name] for value in values], n_seed) for name in values[0]}
    return np.repeat(np.array(values).reshape(len(values), -1), n_seed, axis=0)
