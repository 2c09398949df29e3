"""A scenario on random feeders and its members, the same scenario on one of these feeders each."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np

from dcgrid_env.core.cache import fields_alone
from dcgrid_env.core.seeds import whole_seed
from dcgrid_env.grid.random_feeders.family import HELD_OUT, RandomFeeders
from dcgrid_env.grid.random_feeders.feeder_batch import FeederBatch
from dcgrid_env.scenario.errors import ScenarioError

KEPT = 2 * HELD_OUT
"""Members that a scenario keeps with what is derived from them: those that were asked for last."""


def member_of(scenario: Any, key: int) -> Any:
    """The scenario on the feeder of a key of ``RandomFeeders.keys``."""
    kept: OrderedDict[int, Any] = scenario.__dict__.setdefault("_members", OrderedDict())
    if key in kept:
        kept.move_to_end(key)
        return kept[key]
    member = scenario.replace(feeder=scenario.feeder.feeder(scenario.generator_split, key))
    member.__dict__["_family"] = scenario
    kept[key] = member
    if len(kept) > KEPT:
        kept.popitem(last=False)
    return member


def member(scenario: Any, seeds: int | Sequence[int] | np.ndarray) -> Any:
    """The scenario on the one feeder of some episodes, the first of each seed; see ``Scenario.member``."""
    asked = [seeds] if isinstance(seeds, int | np.integer) else seeds
    groups = members(scenario, asked)
    if len(groups) != 1:
        how = f"seeds within a multiple of {scenario.feeder.batch}" if scenario.split == "train" else "one at a time"
        raise ScenarioError(
            f"scenario {scenario.name!r}: these {len(asked)} episodes are on {len(groups)} feeders, and here all must "
            f"be on one; give {how}, or another batch to RandomFeeders"
        )
    return groups[0][0]


def members(scenario: Any, seeds: Sequence[int] | np.ndarray) -> list[tuple[Any, np.ndarray]]:
    """The scenario on each of the feeders of the first episodes of seeds, see ``Scenario.members``."""
    first = np.array([whole_seed(seed) % 2**64 for seed in seeds], np.uint64)
    if not isinstance(scenario.feeder, RandomFeeders):
        return [(scenario, np.arange(len(first)))]
    return grouped(scenario, first, np.zeros_like(first))


def grouped(scenario: Any, seeds: np.ndarray, numbers: np.ndarray) -> list[tuple[Any, np.ndarray]]:
    """Members, each with the positions of its episodes in order.

    Parameters
    ----------
    scenario
        On random feeders.
    seeds, numbers
        The seed of each episode, and the number of episodes since that, (row,) uint64 each.
    """
    keys, key_index = np.unique(scenario.feeder.keys(scenario.generator_split, seeds, numbers), return_inverse=True)
    return [(member_of(scenario, int(key)), np.flatnonzero(key_index == i)) for i, key in enumerate(keys)]


def on_batch(scenario: Any, groups: Sequence[tuple[Any, np.ndarray]]) -> Any:
    """The scenario for a batch of environments on the feeders of ``grouped``, for the engine alone."""
    batch = FeederBatch(scenario.feeder, tuple((member.feeder, env_indices) for member, env_indices in groups))
    made = object.__new__(type(scenario))
    made.__setstate__(fields_alone(scenario) | {"feeder": batch})
    made.__dict__["_family"] = scenario
    return made
