"""A scenario on random feeders and its members, the same scenario on one of these feeders each."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np

from dcgrid_env.core.cache import fields_alone
from dcgrid_env.grid.random_feeders.family import HELD_OUT
from dcgrid_env.grid.random_feeders.feeder_batch import FeederBatch

KEPT = 2 * HELD_OUT
"""Members that a scenario keeps with what is derived from them: those that were asked for last."""


def member_of(scenario: Any, key: int) -> Any:
    """Return the scenario on the feeder of a key of ``RandomFeeders.keys``."""
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


def grouped(scenario: Any, seeds: np.ndarray, numbers: np.ndarray) -> list[tuple[Any, np.ndarray]]:
    """Return members, each with the positions of its episodes in order.

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
    """Return the scenario for a batch of environments on the feeders of ``grouped``, for the engine alone."""
    batch = FeederBatch(scenario.feeder, tuple((member.feeder, env_indices) for member, env_indices in groups))
    on_feeders = object.__new__(type(scenario))
    on_feeders.__setstate__(fields_alone(scenario) | {"feeder": batch})
    on_feeders.__dict__["_family"] = scenario
    return on_feeders
