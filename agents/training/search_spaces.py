"""What a search over an algorithm's settings looks at: a range or choices for each field of its configuration.

The algorithm's own defaults lie within, and so do the settings that ship (a test holds that): searches begin with them.
"""

from __future__ import annotations

from typing import Any, NamedTuple


class Range(NamedTuple):
    """Numbers from low to high, on a logarithmic scale where so said."""

    low: float
    high: float
    log: bool = False


class Choice(NamedTuple):
    """Some values, in no order."""

    values: tuple[Any, ...]


SPACES: dict[str, dict[str, Range | Choice]] = {
    "analytic": {
        "learning_rate": Range(1e-3, 3e-2, log=True),
        "window": Choice((20, 40, 60, 120)),
        "num_envs": Choice((16, 32, 64, 128)),
        "max_grad_norm": Range(0.1, 10.0, log=True),
    },
    "safe": {
        "learning_rate": Range(1e-3, 3e-2, log=True),
        "window": Choice((20, 40, 60, 120)),
        "margin": Range(0.2, 0.9),
    },
    "cem": {
        "std": Range(0.03, 1.0, log=True),
        "extra_std": Range(0.005, 0.1, log=True),
        "elites": Choice((8, 12, 16, 24)),
    },
}
"""Search spaces by algorithm; other settings are those found for the scenario."""


def within(space: Range | Choice, value: Any) -> bool:
    """Whether a value lies in a space."""
    return value in space.values if isinstance(space, Choice) else space.low <= value <= space.high
