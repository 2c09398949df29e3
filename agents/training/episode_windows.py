"""Which episodes a training by gradients drives, and how they are cut into windows."""

from __future__ import annotations


def windows(horizon: int, window: int) -> list[int]:
    """Lengths of an episode's windows, as equal as they come and about as long as asked."""
    n = max(1, round(horizon / window))
    return [(horizon * (k + 1)) // n - (horizon * k) // n for k in range(n)]


def episode_seeds(seed: int, iteration: int, num_envs: int) -> range:
    """Seeds of a batch of episodes; no two batches of a run, nor runs of other seeds, share one."""
    first = (seed << 40) + iteration * num_envs
    return range(first, first + num_envs)
