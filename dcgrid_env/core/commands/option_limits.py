"""Least and largest value of every numeric option of the commands, one table for all.

A command checks its options before it does anything, so a number with some digits too many takes no memory. The
settings of trainings have their own table, ``agents.training.config``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from dcgrid_env.core.seeds import MOST_EPISODES, MOST_SAMPLES

MOST_WORKERS = 4096
_A_YEAR_S = 366.0 * 86_400.0
_ANY_SEED = (0, 2**63 - 1)
LIMITS: Mapping[str, tuple[float, float]] = {
    "episodes": (1, MOST_EPISODES),
    "samples": (1, MOST_SAMPLES),
    "horizon": (1, 100_000_000),
    "workers": (1, MOST_WORKERS),
    "seeds": (1, 10_000),
    "seed": _ANY_SEED,
    "round_seed": _ANY_SEED,
    "behaviour_seed": _ANY_SEED,
    "gpus": (0, 4095),
    "every": (1, 1_000_000),
    "fps": (0.1, 100),  # GIF frame times are multiples of 0.01 s
    "hz": (0.001, 1000.0),
    "noise": (0, 2),  # the width of the action range
    "frequency_hz": (1.0, 1000.0),
    "seconds": (0.001, 86_400.0),
    "duration_s": (0.0, _A_YEAR_S),
    "dt_s": (1e-3, 3600.0),
    "step_s": (1e-6, _A_YEAR_S),
    "part_s": (0.0, 1e12),
    "max_gap_s": (0.0, _A_YEAR_S),
    "limit_kw": (1e-6, 1e7),
    "rated_kw": (1e-6, 1e7),
    "window_s": (1e-3, 3600.0),
    "settle_s": (0.0, 3600.0),
    "loading_max_pct": (0.0, 10_000.0),
    "voltage_step_max_pct": (0.0, 100.0),
    "taps_max_per_hour": (0.0, 1e6),
    "loss_max_kw": (0.0, 1e7),
    "allowed_pct": (0.0, 100.0),
    "tolerance_mw": (1e-6, 1e4),
    "max_mw": (1e-6, 1e4),
}
"""By name of the option; a command may allow less."""


def check_limits(options: Any) -> None:
    """Raise ValueError for the first number of a command that is NaN or outside its limits; the message names both."""
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        for one in value if isinstance(value, tuple) else (value,):
            if field.name in LIMITS and isinstance(one, int | float):
                check_limit(field.name, one)


def check_limit(name: str, value: float) -> None:
    """Raise ValueError unless a value of an option is within its limits."""
    low, high = LIMITS[name]
    if not low <= value <= high:
        wanted = f"at most {high:,}" if value > high else f"at least {low:,}"
        raise ValueError(f"{name}: must be {wanted}, got {value if isinstance(value, int) else f'{value:g}'}")
