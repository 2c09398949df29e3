"""Which episodes a training by gradients runs through, and how it cuts them into windows."""

from __future__ import annotations

from collections.abc import Sequence

from dcgrid_env import RandomFeeders, Scenario

NORMALISED_ENVS, NORMALISED_STEPS = 32, 10
"""Episodes, and steps between new setpoints, of the rollout that normalises observations."""


FEEDERS = 8
"""Feeders over which that rollout goes where they are random."""


def normalising_seeds(scenario: Scenario, seed: int) -> list[range]:
    """Seeds of the episodes that normalise observations, a batch on each of several feeders where they are random."""
    if not isinstance(scenario.feeder, RandomFeeders):
        return [episode_seeds(seed, 0, NORMALISED_ENVS)]
    n_env = min(NORMALISED_ENVS, scenario.feeder.batch)
    first = [(seed << 40) + i * scenario.feeder.batch for i in range(FEEDERS)]
    return [range(start, start + n_env) for start in first]


def check_batch(scenarios: Sequence[Scenario], num_envs: int) -> None:
    """ValueError, naming the field, unless a batch of episodes is on one feeder where feeders are random."""
    for scenario in scenarios:
        if isinstance(scenario.feeder, RandomFeeders) and scenario.feeder.batch % num_envs:
            batch = scenario.feeder.batch
            raise ValueError(
                f"num_envs is {num_envs}; {scenario.name} has another feeder after each {batch} episodes, and "
                f"gradients are of one feeder at a time: give {batch} or a divisor of it"
            )


def windows(horizon: int, window: int) -> list[int]:
    """Lengths of an episode's windows, as equal as they come and about as long as asked."""
    n = max(1, round(horizon / window))
    return [(horizon * (k + 1)) // n - (horizon * k) // n for k in range(n)]


def episode_seeds(seed: int, iteration: int, num_envs: int) -> range:
    """Seeds of a batch of episodes; no two batches of a run, nor runs of other seeds, share one."""
    first = (seed << 40) + iteration * num_envs
    return range(first, first + num_envs)
