"""Which episodes a training by gradients runs through, and how it cuts them into windows."""

from __future__ import annotations

NORMALISED_LANES, NORMALISED_STEPS = 32, 10
"""Episodes, and steps between new setpoints, of the rollout that normalises observations."""


def windows(horizon: int, window: int) -> list[int]:
    """Lengths of an episode's windows, as equal as they come and about as long as asked."""
    n = max(1, round(horizon / window))
    return [(horizon * (k + 1)) // n - (horizon * k) // n for k in range(n)]


def episode_seeds(seed: int, iteration: int, num_envs: int) -> range:
    """Seeds of a batch of episodes; no two batches of a run, nor runs of other seeds, share one."""
    first = (seed << 40) + iteration * num_envs
    return range(first, first + num_envs)
