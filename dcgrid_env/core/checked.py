"""Dataclass fields that define their allowed values, and an error with the field, value and remedy.

    noise_pu: float = number(0.0, 1.0, default=0.0)

A class calls :func:`check_fields` in its ``__post_init__``; a class that contains it adds the path.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, field
from numbers import Integral, Real
from typing import Any

import numpy as np

from dcgrid_env.core.suggestions import unknown

Plain = Any
"""Data as JSON and TOML hold it: None, bool, int, float, str, and lists and dictionaries of these."""
DEEPEST = 64
"""Most lists and mappings within each other."""
_LONGEST_SHOWN = 200
_LARGEST = sys.float_info.max
"""Largest finite number; larger whole numbers are refused."""
_SMALLEST = sys.float_info.min
"""Smallest number above 0 of full precision."""


class FieldError(ValueError):
    """A value that a field cannot take.

    Parameters
    ----------
    owner
        The class that the field belongs to, or the path that leads to it.
    name, value
        Field and value.
    remedy
        Allowed values; the whole message for the field if ``value`` is ``...``.
    """

    def __init__(self, owner: str, name: str, value: object, remedy: str):
        self.owner, self.name, self.value, self.remedy = owner, name, value, remedy
        super().__init__(f"{owner}: {self.said(name)}")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.owner, self.name, self.value, self.remedy)

    def said(self, name: str) -> str:
        """The message under another name of the field."""
        return f"{name} {self.remedy}" if self.value is ... else f"{name} is {shown(self.value)}; {self.remedy}"

    def within(self, owner: str, field: str) -> FieldError:
        """The error of a value that is itself in a field of ``owner``."""
        return FieldError(owner, f"{field}.{self.name}", self.value, self.remedy)


def shown(value: object) -> str:
    """Return a value as text for a message, shortened if it is long."""
    try:
        text = repr(value)
    except ValueError:
        return f"a number of more than {sys.get_int_max_str_digits()} digits"
    return text if len(text) <= _LONGEST_SHOWN else f"{text[: _LONGEST_SHOWN - 3]}..."


def is_deep(value: object) -> bool:
    """Return whether lists, tuples and mappings are nested more than ``DEEPEST`` deep, or contain themselves."""
    level = [value]
    for _ in range(DEEPEST):
        level = [part for one in level for part in _parts(one) if isinstance(part, (dict, list, tuple))]
        if not level:
            return False
    return True


def _parts(value: object) -> Iterable[object]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, (list, tuple)) else ()


class UnknownFieldError(FieldError):
    """A field that does not exist.

    Parameters
    ----------
    owner, name, value
        Class, name of the field and value, see ``FieldError``.
    names
        The fields that exist.
    """

    def __init__(self, owner: str, name: str, value: object, names: Iterable[str]):
        self.names = list(names)
        super().__init__(owner, name, value, "")

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.owner, self.name, self.value, self.names)

    def said(self, name: str) -> str:
        """The message under another name of the field."""
        owner, _, field = str(name).rpartition(".")
        return unknown(f"{owner or self.owner} field", field, self.names, f"its fields are {', '.join(self.names)}")

    def within(self, owner: str, field: str) -> FieldError:
        """The error of a value that is itself in a field of ``owner``."""
        return UnknownFieldError(owner, f"{field}.{self.name}", self.value, self.names)


def is_number(value: object) -> bool:
    """Return whether ``value`` is a real number, not a bool and not subnormal, which would lose digits."""
    return isinstance(value, Real) and not isinstance(value, bool) and not _is_subnormal(value)


def _is_subnormal(value: Any) -> bool:
    return 0 < abs(value) < _SMALLEST


def number(low: float, high: float | str, default: object = MISSING) -> Any:
    """Return a field for a finite number in [low, high]; ``high`` may name another field of the class."""
    return field(default=default, metadata={"check": _check_number, "bounds": (low, high)})


def count(low: int, high: int, default: object = MISSING) -> Any:
    """Return a field for a whole number from ``low`` to ``high``."""
    return field(default=default, metadata={"check": _check_count, "bounds": (low, high)})


def choice(*options: Any, default: object = MISSING) -> Any:
    """Return a field for one of some values, of their type."""
    return field(default=default, metadata={"check": _check_choice, "options": options})


def as_plain(value: object) -> Plain:
    """Return a NumPy scalar as a Python number; any other value unchanged."""
    return value.item() if isinstance(value, np.generic) else value


def settle(owner: Any, **conversions: Callable[[Any], Any]) -> None:
    """Convert the fields of a frozen dataclass instance: lists and arrays to tuples, NumPy scalars to Python numbers.

    ``conversions`` has a function for each field with a plain form, which converts plain data."""
    for f in dataclasses.fields(owner):
        given = getattr(owner, f.name)
        value = conversions[f.name](given) if f.name in conversions else given
        if isinstance(value, np.ndarray):
            value = value.tolist()  # a number where it has no dimension
        if isinstance(value, list):
            value = tuple(map(as_plain, value))
        value = as_plain(value)
        if value is not given:
            object.__setattr__(owner, f.name, value)


def from_mapping(kind: type[Any], value: object) -> Any:
    """Return a dataclass instance for its plain form, a mapping of its fields; any other value unchanged.

    FieldError for an unknown field, or a missing one without a default.
    """
    if not isinstance(value, Mapping):
        return value
    there = {f.name: f for f in dataclasses.fields(kind)}
    for name in value:
        if name not in there:
            raise UnknownFieldError(kind.__name__, name, value[name], there)
    for name, f in there.items():
        if name not in value and f.default is MISSING and f.default_factory is MISSING:
            raise FieldError(kind.__name__, name, ..., "is missing; give it")
    return kind(**value)


def changed_fields(instance: Any) -> dict[str, Any]:
    """Return the fields of a dataclass instance that are not at their default, by name."""
    given = ((f, getattr(instance, f.name)) for f in dataclasses.fields(instance))
    return {f.name: value for f, value in given if f.default is MISSING or value != f.default}


def check_fields(owner: Any) -> None:
    """Raise FieldError for the first invalid field of a dataclass instance among the fields made with this module."""
    for f in dataclasses.fields(owner):
        if check := f.metadata.get("check"):
            check(owner, f)


def refuse(owner: object, name: str, remedy: str) -> FieldError:
    """Return the error of a field of a dataclass instance."""
    return FieldError(type(owner).__name__, name, getattr(owner, name), remedy)


def _check_number(owner: object, f: dataclasses.Field[Any]) -> None:
    low, bound = f.metadata["bounds"]
    high = getattr(owner, bound) if isinstance(bound, str) else bound
    value = getattr(owner, f.name)
    if not (is_number(value) and is_number(high) and low <= value <= min(high, 1e300)):
        upper = f"{bound} = {high:g}" if isinstance(bound, str) and is_number(high) else f"{high:g}"
        raise refuse(owner, f.name, f"give a finite number in [{low:g}, {upper}]{_not_subnormal(value)}")


def _not_subnormal(value: object) -> str:
    subnormal = isinstance(value, Real) and _is_subnormal(value)
    return f", 0 or of at least {_SMALLEST:.1e} in size" if subnormal else ""


def _check_count(owner: object, f: dataclasses.Field[Any]) -> None:
    low, high = f.metadata["bounds"]
    value = getattr(owner, f.name)
    if not isinstance(value, Integral) or isinstance(value, bool) or not low <= int(value) <= high:
        raise refuse(owner, f.name, f"give a whole number of at least {low} and at most {high:,}")


def _check_choice(owner: object, f: dataclasses.Field[Any]) -> None:
    options = f.metadata["options"]
    value = getattr(owner, f.name)
    if type(value) is not type(options[0]) or value not in options:
        raise refuse(owner, f.name, f"choose one of {', '.join(map(str, options))}")


def finite(value: Any, low: float = -math.inf, high: float = math.inf) -> bool:
    """Return whether it is a finite number within bounds."""
    return is_number(value) and -_LARGEST <= value <= _LARGEST and low <= value <= high
