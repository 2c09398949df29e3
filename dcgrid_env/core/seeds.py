"""Seeds of episodes as they are given."""

from __future__ import annotations

import numpy as np

MOST_EPISODES = 100_000
"""Most episodes of one command."""
MOST_SAMPLES = 10_000
"""Most windows that a capacity is computed from."""
MOST_ENVS = 2_000_000
"""Most environments in a batch."""


def whole_seed(seed: object) -> int:
    """A seed as an int; ValueError unless it is a whole number of at least 0."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed is {seed!r}; give a whole number of at least 0")
    return int(seed)


def as_seed(seed: object) -> int | None:
    """Return a seed as an int, None unchanged; ValueError unless it is a whole number of at least 0."""
    return None if seed is None else whole_seed(seed)
