"""One walker that hashes values by what they hold, behind every fingerprint."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import numpy as np

DIGITS = 16  # hexadecimal digits kept: 64 bits


class Fields(Protocol):
    """Function that selects the hashed parts of a value other than its dataclass fields: see ``fingerprint``."""

    def __call__(self, value: object) -> tuple[str, Iterable[tuple[str, Any]]] | None:
        """Return a name for the value's type and its fields in order; None for the default treatment."""
        ...


def digest(parts: Iterable[tuple[str, Any]], fields: Fields | None = None) -> str:
    """SHA-256 over named values, 16 hexadecimal digits; a name may be empty.

    Parameters
    ----------
    parts
        Names and values: numbers, texts, arrays, tuples, lists, mappings, dataclasses, and objects with a ``__dict__``.
    fields
        What of a value is hashed where that is not all its fields.

    Raises
    ------
    ValueError
        For an object whose figures cannot be read.
    """
    found = hashlib.sha256()
    for name, value in parts:
        found.update(name.encode())
        _add(found, value, fields)
    return found.hexdigest()[:DIGITS]


def _add(found: Any, value: object, fields: Fields | None) -> None:
    """Feed a value: its type, its length where it has one, and what it holds."""
    explicit = fields(value) if fields else None
    if explicit is not None:
        name, held = explicit
        found.update(name.encode())
        _add_named(found, held, fields)
    elif isinstance(value, np.ndarray):
        found.update(f"array{value.shape}{value.dtype.kind}".encode())
        found.update(np.ascontiguousarray(value.astype(np.float64) if value.dtype.kind in "iufb" else value).tobytes())
    elif dataclasses.is_dataclass(value):
        found.update(type(value).__name__.encode())
        _add_named(found, ((f.name, getattr(value, f.name)) for f in dataclasses.fields(value)), fields)
    elif isinstance(value, tuple | list):
        found.update(f"tuple{len(value)}".encode())
        for item in value:
            _add(found, item, fields)
    elif isinstance(value, bool | str | None):
        found.update(f"{type(value).__name__}:{value};".encode())
    elif isinstance(value, int | float | np.number):
        found.update(f"number:{float(value)!r};".encode())
    elif isinstance(value, Mapping):
        _add(found, tuple(sorted(value.items())), fields)
    else:  # a clock law of one's own that is no dataclass
        if not hasattr(value, "__dict__"):
            raise ValueError(
                f"{type(value).__name__} has __slots__, so its fields cannot be hashed; give it a __dict__ or make it "
                "a dataclass"
            )
        found.update(f"{type(value).__name__};".encode())
        _add(found, vars(value), fields)


def _add_named(found: Any, held: Iterable[tuple[str, Any]], fields: Fields | None) -> None:
    for name, value in held:
        found.update(name.encode())
        _add(found, value, fields)
