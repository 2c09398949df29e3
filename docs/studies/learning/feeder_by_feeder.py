"""Scores of controllers on each feeder of a random family by itself, over several episodes of that feeder.

The published episodes of a family contain each of its feeders once or twice, with one placement and one load
trajectory. If an episode leaves little to gain, its score does not describe the feeder. This study runs the same number
of episodes on every feeder, with that feeder's first seeds, and solves hindsight for each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from dcgrid_env import make_scenario
from dcgrid_env.agents import find_controller
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import rollout
from dcgrid_env.baselines.carried import carried
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.score import REFERENCE
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Place, Unit


class _Asked(NamedTuple):
    """Controllers on the first episodes of a feeder."""

    names: tuple[str, ...]
    scenario: str
    split: str
    first: int
    """The family's episode that the feeder is first met in."""
    each: int


class OnFeeder(NamedTuple):
    """Costs on a feeder's episodes."""

    first: int
    """The family's episode that the feeder is first met in."""
    J: dict[str, np.ndarray]
    """By controller, the tuned droop among them, (n_episode,)."""
    best: np.ndarray
    """With perfect foresight, (n_episode,)."""

    def score(self, name: str) -> float:
        """Score of a controller, a ratio of means over the episodes."""
        droop = self.J[REFERENCE]
        return float((droop - self.J[name]).mean() / (droop - self.best).mean())


def on_each_feeder(
    names: Sequence[str],
    scenario: str,
    split: str,
    episodes: int,
    each: int,
    place: Place = ONE_PROCESS,
    on_begin: Callable[[int], None] = lambda feeders: None,
    on_feeder: Callable[[], None] = lambda: None,
) -> list[OnFeeder]:
    """Drive each feeder that the first episodes of a family fall on, as units of a place.

    Parameters
    ----------
    names
        Controllers that drive the scenario.
    scenario
        Name of a scenario on random feeders.
    split
        Whose feeders.
    episodes
        Episodes 0, 1, .. of the family whose feeders are driven.
    each
        Episodes of each feeder: its seeds 0, 1, ..
    place
        Where they are driven.
    on_begin
        Called with the number of feeders.
    on_feeder
        Called after each.
    """
    family = make_scenario(scenario, split=split)
    every = tuple(dict.fromkeys((REFERENCE, *names)))
    firsts = sorted(int(at[0]) for _, at in family.members(range(episodes)))
    units = [
        Unit(f"{scenario}, the feeder of episode {first}", _driven, _Asked(every, scenario, split, first, each))
        for first in firsts
    ]
    on_begin(len(units))
    found: dict[int, OnFeeder] = {}
    for unit, result in place.results(units, carried(place, (), names), how_to_go_on=""):
        found[unit.item.first] = result
        on_feeder()
    return [found[first] for first in firsts]


def _driven(asked: _Asked) -> OnFeeder:
    family = make_scenario(asked.scenario, split=asked.split)
    on, seeds = family.member(asked.first), range(asked.each)
    with on_purpose():
        costs = {name: rollout(on, find_controller(name, family), seeds).costs() for name in asked.names}
    return OnFeeder(asked.first, costs, np.array([hindsight(on, seed).J for seed in seeds]))
