"""Equality of the values of fields, those included that compare by identity."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np


def alike(a: Any, b: Any) -> bool:
    """Equality that looks into arrays, and into feeders and traces, which compare by identity."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(alike, a, b))
    if dataclasses.is_dataclass(a):
        return all(alike(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    return a == b or (a != a and b != b)  # a figure that is not known is NaN
