"""Bounds of every figure that an algorithm can be set to, one table for all algorithms."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from dcgrid_env.agents.policy.history_network import MOST_STEPS

MOST_SEEDS = 2**24
"""Training seeds whose episodes are not those of another one."""
_MANY = 1e9
ABOVE_0: Mapping[str, float] = {
    **dict.fromkeys(("num_envs", "validation_episodes", "population", "elites", "window"), 100_000),
    **dict.fromkeys(("feeders", "validation_feeders"), 10_000),
    **dict.fromkeys(("updates", "iterations"), _MANY),
    **dict.fromkeys(("validate_every", "checkpoint_every"), _MANY),
    **dict.fromkeys(("max_grad_norm", "trip_width_s", "delay_limit_s", "violation_limit_pu"), _MANY),
    **dict.fromkeys(("dual_rate", "std"), 10.0),
    "learning_rate": 1.0,
    "steps": 1e15,
    "threads": 4096,
}
"""Largest value of what must be above 0."""
WITHIN: Mapping[str, tuple[float, float]] = {
    "seed": (0, MOST_SEEDS - 1),
    "extra_std": (0.0, 10.0),
    "vary": (0, 10_000),
    "history": (0, MOST_STEPS),
    "trip_width_pu": (0.0, 1.0),
    "margin": (1e-6, 1.0 - 1e-6),
}
"""Least and largest value of all others."""
WIDEST = 65_536
"""Most units of a hidden layer."""
MOST_WEIGHTS = 2**26
"""Most weights between hidden layers; a policy file of them is as large as files that are read."""


def check_figures(settings: Mapping[str, Any]) -> None:
    """Raise ValueError, naming the field, if a figure is out of its bounds; None is ignored."""
    for field, value in settings.items():
        if value is None:
            continue
        if field in ABOVE_0 and not (0 < value <= ABOVE_0[field]):
            raise ValueError(f"{field} is {value}; give more than 0 and at most {ABOVE_0[field]:g}")
        if field in WITHIN and not WITHIN[field][0] <= value <= WITHIN[field][1]:
            low, high = WITHIN[field]
            raise ValueError(f"{field} is {value}; give at least {low:g} and at most {high:.9g}")
    hidden = settings.get("hidden", ())
    if not all(0 < width <= WIDEST for width in hidden):
        raise ValueError(f"hidden is {hidden}; give widths from 1 to {WIDEST}")
    if sum(one * other for one, other in pairwise(hidden)) > MOST_WEIGHTS:
        raise ValueError(f"hidden is {hidden}; give widths with at most {MOST_WEIGHTS:,} weights between the layers")
