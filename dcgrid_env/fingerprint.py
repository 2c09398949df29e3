"""Hashes of a scenario and of an episode, so that a published figure can be told to be of the same thing.

A scenario's covers all its fields, by value, but for a field that came after hashes were published and is at its
default. An episode's covers what comes from outside (:class:`Forecast`), rounded
to 2^-7 kW: should a machine's arithmetic differ in the last bit, a figure in some 10^10 falls to the other side.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from dcgrid_env.foresight import forecast
from dcgrid_env.scenario import Scenario

_DIGITS = 16  # hexadecimal digits kept: 64 bits


def scenario_hash(scenario: Scenario) -> str:
    """SHA-256 of a scenario's fields, 16 hexadecimal digits."""
    digest = hashlib.sha256()
    _add(digest, scenario)
    return digest.hexdigest()[:_DIGITS]


def episode_hash(scenario: Scenario, seed: int) -> str:
    """SHA-256 of what comes from outside in the first episode of a seed, 16 hexadecimal digits."""
    digest = hashlib.sha256()
    for name, values in forecast(scenario, seed)._asdict().items():
        digest.update(name.encode())
        _add(digest, np.round(values * 2.0**7) + 0.0)  # no negative zero
    return digest.hexdigest()[:_DIGITS]


def _add(digest: Any, value: Any) -> None:
    """Feed a value: its type, its length where it has one, and what it holds."""
    if isinstance(value, np.ndarray):
        digest.update(f"array{value.shape}{value.dtype.kind}".encode())
        digest.update(np.ascontiguousarray(value.astype(np.float64) if value.dtype.kind in "iufb" else value).tobytes())
    elif dataclasses.is_dataclass(value):
        digest.update(type(value).__name__.encode())
        for field in dataclasses.fields(value):
            held = getattr(value, field.name)
            if field.metadata.get("unhashed_default") and held == field.default:
                continue
            digest.update(field.name.encode())
            _add(digest, held)
    elif isinstance(value, tuple):
        digest.update(f"tuple{len(value)}".encode())
        for item in value:
            _add(digest, item)
    elif isinstance(value, bool | str | None):
        digest.update(f"{type(value).__name__}:{value};".encode())
    elif isinstance(value, int | float | np.number):
        digest.update(f"number:{float(value)!r};".encode())
    elif isinstance(value, Mapping):
        _add(digest, tuple(sorted(value.items())))
    else:  # a clock law of one's own that is no dataclass
        if not hasattr(value, "__dict__"):
            raise ValueError(
                f"{type(value).__name__} has __slots__, so its fields cannot be hashed; give it a __dict__ or make it "
                "a dataclass"
            )
        digest.update(f"{type(value).__name__};".encode())
        _add(digest, vars(value))
