"""Checks of controllers' parameters."""

from __future__ import annotations

import math


def require_non_negative(controller: str, **values: float) -> None:
    """ValueError naming the controller and the parameter unless all are finite numbers >= 0."""
    for name, value in values.items():
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{controller}: {name} is {value!r}; give a finite number >= 0")


def require_finite(controller: str, **values: float) -> None:
    """Check numbers of either sign."""
    for name, value in values.items():
        if not math.isfinite(value):
            raise ValueError(f"{controller}: {name} is {value!r}; give a finite number")
