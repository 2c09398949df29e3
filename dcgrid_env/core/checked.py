"""Dataclass fields that define their allowed values, and an error with the field, value and remedy.

    noise_pu: float = number(0.0, 1.0, default=0.0)

A class calls :func:`settle` in its ``__post_init__``; a class that contains it adds the path.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, field
from functools import cache
from numbers import Integral, Real
from typing import Any

import numpy as np

from dcgrid_env.core.suggestions import nearest

Plain = Any
"""Data as JSON and TOML hold it: None, bool, int, float, str, and lists and dictionaries of these."""
DEEPEST = 64
"""Most lists and mappings within each other."""
_LONGEST_SHOWN = 200
_PYTHON = (float, int, bool, str, type(None))
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
        dot = "" if str(self.name).startswith("[") else "."
        return FieldError(owner, f"{field}{dot}{self.name}", self.value, self.remedy)


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


def is_number(value: object) -> bool:
    """Return whether ``value`` is a real number, not a bool and not subnormal, which would lose digits."""
    return isinstance(value, Real) and not isinstance(value, bool) and not _is_subnormal(value)


def _is_subnormal(value: Any) -> bool:
    return 0 < abs(value) < _SMALLEST


class _RefusedError(ValueError):
    """Error of a value; the message is the remedy."""


def number(low: float, high: float | str, default: object = MISSING) -> Any:
    """Return a field for a finite number in [low, high]; ``high`` may name another field of the class."""

    def take(owner: object, value: Any) -> Any:
        most = getattr(owner, high) if isinstance(high, str) else high
        if finite(value, low, most):
            return value
        upper = f"{high} = {most:g}" if isinstance(high, str) else f"{most:g}"
        subnormal = f", 0 or of at least {_SMALLEST:.1e} in size" * (isinstance(value, Real) and _is_subnormal(value))
        raise _RefusedError(f"give a finite number in [{low:g}, {upper}]{subnormal}")

    return _field(take, default, bounds=(low, high))


def count(low: int, high: int, default: object = MISSING) -> Any:
    """Return a field for a whole number from ``low`` to ``high``."""

    def take(_: object, value: Any) -> Any:
        if isinstance(value, Integral) and not isinstance(value, bool) and low <= int(value) <= high:
            return value
        raise _RefusedError(f"give a whole number of at least {low} and at most {high:,}")

    return _field(take, default, bounds=(low, high))


def choice(*options: Any, default: object = MISSING) -> Any:
    """Return a field for one of some values, of their type."""

    def take(_: object, value: Any) -> Any:
        if type(value) is type(options[0]) and value in options:
            return value
        raise _RefusedError(f"choose one of {', '.join(map(str, options))}")

    return _field(take, default)


def span(low: float, high: float, default: object = MISSING) -> Any:
    """Return a field for a lowest and a highest number in [low, high]; one number is a range without width."""

    def take(_: object, value: Any) -> Any:
        pair = (value, value) if is_number(value) else value
        if not isinstance(pair, tuple) or len(pair) != 2 or not all(_in_range(one, low, high) for one in pair):
            raise _RefusedError(f"give a number from {low:g} to {high:g}, or a pair of them, a lowest and a highest")
        if pair[0] > pair[1]:
            raise _RefusedError("give the lowest first")
        return float(pair[0]), float(pair[1])

    return _field(take, default)


def pairs(default: object) -> Any:
    """Return a field for pairs of a name and a value, or the mapping from names to values that they represent."""
    return _field(lambda _, value: as_tuples(as_pairs(value)), default, is_mapping=True)


def part(kind: type[Any], default: object = MISSING, text: str = "") -> Any:
    """Return a field for an instance of a dataclass, or a mapping of its fields.

    Parameters
    ----------
    kind
        The dataclass.
    default
        Default of the field; ``kind()`` if it is left out.
    text
        Field of ``kind`` that a text alone gives; "" for none.
    """

    def take(_: object, value: Any) -> Any:
        made = from_mapping(kind, {text: value} if text and isinstance(value, str) else value)
        if isinstance(made, kind):
            return made
        raise _RefusedError(f"give {kind.__name__}(...) or a mapping of its fields")

    if default is MISSING:
        return field(default_factory=kind, metadata={"take": take})
    return _field(take, default)


def parts(kind: type[Any]) -> Any:
    """Return a field for a tuple of instances of a dataclass, or of mappings of its fields; one alone is taken too."""

    def take(_: object, value: Any) -> Any:
        items, made = (value,) if isinstance(value, kind | Mapping) else value, list[Any]()
        for i, item in enumerate(items if isinstance(items, tuple) else (items,)):
            with inside(kind.__name__, f"[{i}]"):
                made.append(from_mapping(kind, item))
        if all(isinstance(item, kind) for item in made):
            return tuple(made)
        raise _RefusedError(f"give a list of {kind.__name__}(...) or of mappings of its fields, () for none")

    return _field(take, ())


def _field(take: Callable[[Any, Any], Any], default: object, **metadata: object) -> Any:
    """Return a field whose values a function converts, or refuses with a remedy; None is allowed as the default."""
    return field(default=default, metadata={"take": take, **metadata})


def as_pairs(value: object) -> Any:
    """Return the pairs of a mapping, with names as text; any other value unchanged."""
    return tuple((str(name), item) for name, item in value.items()) if isinstance(value, Mapping) else value


def as_tuples(value: object) -> Any:
    """Return lists and arrays, also those within lists, as tuples, and NumPy scalars as Python numbers."""
    if type(value) in _PYTHON:
        return value
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()  # a number where it has no dimension
    if type(value) not in (list, tuple):
        return value
    items: Any = value
    made = tuple(map(as_tuples, items))
    return value if type(value) is tuple and all(a is b for a, b in zip(made, items, strict=True)) else made


def settle(owner: Any, **conversions: Callable[[Any], Any]) -> None:
    """Convert and check the fields of a frozen dataclass instance in its ``__post_init__``.

    Lists and arrays become tuples, NumPy scalars Python numbers, and plain data what the field declares.
    ``conversions`` has a function for each further field that converts plain data. FieldError is raised for the first
    invalid field among those made with this module.
    """
    kind = type(owner)
    for f in _fields(kind):
        before = getattr(owner, f.name)
        value = as_tuples(conversions[f.name](before) if f.name in conversions else before)
        if "take" in f.metadata and not (value is None and f.default is None):
            try:
                value = f.metadata["take"](owner, value)
            except _RefusedError as error:
                none = ", or None" if f.default is None else ""
                raise FieldError(kind.__name__, f.name, before, f"{error}{none}") from None
            except FieldError as error:
                raise error.within(kind.__name__, f.name) from None
        if value is not before:
            object.__setattr__(owner, f.name, value)


@cache
def _fields(kind: type[Any]) -> tuple[dataclasses.Field[Any], ...]:
    return dataclasses.fields(kind)


@contextmanager
def inside(owner: str, path: str) -> Iterator[None]:
    """Put a path before the field of a FieldError that is raised within."""
    try:
        yield
    except FieldError as error:
        raise error.within(owner, path) from None


def from_mapping(kind: type[Any], value: object, start: Any = None) -> Any:
    """Return a dataclass instance for its plain form, a mapping of its fields; any other value unchanged.

    The fields that the mapping leaves out are those of ``start``, or at their default. FieldError for an unknown field,
    or a missing one without a default.
    """
    if not isinstance(value, Mapping):
        return value
    there = {f.name: f for f in dataclasses.fields(kind)}
    for name in value:
        if name not in there:
            raise unknown_field(kind.__name__, name, there)
    if start is not None:
        return dataclasses.replace(start, **value) if value else start
    for name, f in there.items():
        if name not in value and f.default is MISSING and f.default_factory is MISSING:
            raise FieldError(kind.__name__, name, ..., "is missing; give it")
    return kind(**value)


def changed_fields(instance: Any) -> dict[str, Any]:
    """Return the fields of a dataclass instance that are not at their default, by name."""
    values = ((f, getattr(instance, f.name)) for f in dataclasses.fields(instance))
    return {f.name: value for f, value in values if f.default is MISSING or value != f.default}


def unknown_field(owner: str, name: object, names: Iterable[str]) -> FieldError:
    """Return the error of a field that does not exist, with the nearest ones of those that do."""
    remedy = nearest(str(name).rpartition(".")[2], names, f"its fields are {', '.join(names)}")
    return FieldError(owner, f"{name}", ..., f"is no field; {remedy}")


def refuse(owner: object, name: str, remedy: str) -> FieldError:
    """Return the error of a field of a dataclass instance."""
    return FieldError(type(owner).__name__, name, getattr(owner, name), remedy)


def finite(value: Any, low: float = -math.inf, high: float = math.inf) -> bool:
    """Return whether it is a finite number within bounds."""
    return _in_range(value, max(low, -_LARGEST), min(high, _LARGEST))


def _in_range(value: Any, low: float = -_LARGEST, high: float = math.inf) -> bool:
    """Return whether it is a number within bounds, and finite or infinite as a float too."""
    return is_number(value) and low <= value <= high and (value <= _LARGEST or value == math.inf)
