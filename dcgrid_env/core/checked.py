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
from functools import cache, partial
from numbers import Integral, Real
from typing import Any

import numpy as np

from dcgrid_env.core.suggestions import unknown

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
        return FieldError(owner, _joined(field, self.name), self.value, self.remedy)


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
        return UnknownFieldError(owner, _joined(field, self.name), self.value, self.names)


def _joined(path: str, name: object) -> str:
    """Return a path with a field added, or an index such as ``[0].kind``."""
    return f"{path}{name}" if str(name).startswith("[") else f"{path}.{name}"


def is_number(value: object) -> bool:
    """Return whether ``value`` is a real number, not a bool and not subnormal, which would lose digits."""
    return isinstance(value, Real) and not isinstance(value, bool) and not _is_subnormal(value)


def _is_subnormal(value: Any) -> bool:
    return 0 < abs(value) < _SMALLEST


def number(low: float, high: float | str, default: object = MISSING) -> Any:
    """Return a field for a finite number in [low, high]; ``high`` may name another field of the class.

    None is allowed if it is the default.
    """
    return field(default=default, metadata={"check": _check_number, "bounds": (low, high)})


def count(low: int, high: int, default: object = MISSING) -> Any:
    """Return a field for a whole number from ``low`` to ``high``."""
    return field(default=default, metadata={"check": _check_count, "bounds": (low, high)})


def choice(*options: Any, default: object = MISSING) -> Any:
    """Return a field for one of some values, of their type."""
    return field(default=default, metadata={"check": _check_choice, "options": options})


def part(kind: type[Any], default: object = MISSING) -> Any:
    """Return a field for an instance of a dataclass, or a mapping of its fields; None is allowed if it is the default.

    Without a default, the field is ``kind()``.
    """
    metadata = {"convert": partial(from_mapping, kind), "check": _check_part, "kind": kind}
    if default is MISSING:
        return field(default_factory=kind, metadata=metadata)
    return field(default=default, metadata=metadata)


def parts(kind: type[Any]) -> Any:
    """Return a field for a tuple of instances of a dataclass, or of mappings of its fields; one alone is taken too."""
    return field(default=(), metadata={"convert": partial(_from_mappings, kind), "check": _check_parts, "kind": kind})


def pairs(default: object) -> Any:
    """Return a field for pairs of a name and a value, or the mapping from names to values that they represent."""
    return field(default=default, metadata={"convert": as_pairs, "is_mapping": True})


def span(low: float, high: float, default: object = MISSING) -> Any:
    """Return a field for a lowest and a highest number in [low, high]; one number is a range without width."""
    metadata = {"convert": partial(_as_span, low, high), "check": _check_span, "bounds": (low, high)}
    return field(default=default, metadata=metadata)


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

    Plain data becomes objects where a field declares it, lists and arrays become tuples, and NumPy scalars Python
    numbers. ``conversions`` has a function for each further field that converts plain data. Then FieldError is raised
    for the first invalid field among those made with this module.
    """
    kind = type(owner)
    for f in _fields(kind):
        value = before = getattr(owner, f.name)
        if f.name in conversions:
            value = conversions[f.name](value)
        if f.metadata and value is not f.default and (convert := f.metadata.get("convert")):
            with inside(kind.__name__, f.name):
                value = convert(value)
        value = as_tuples(value)
        if value is not before:
            object.__setattr__(owner, f.name, value)
    for f in _fields(kind):
        if f.metadata and (check := f.metadata.get("check")):
            check(owner, f)


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
            raise UnknownFieldError(kind.__name__, name, value[name], there)
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


def refuse(owner: object, name: str, remedy: str) -> FieldError:
    """Return the error of a field of a dataclass instance."""
    return FieldError(type(owner).__name__, name, getattr(owner, name), remedy)


def _from_mappings(kind: type[Any], value: object) -> Any:
    """Return instances of a dataclass for their plain forms; any other value unchanged."""
    items = (value,) if isinstance(value, kind | Mapping) else as_tuples(value)
    if not isinstance(items, tuple):
        return value
    made: list[Any] = []
    for i, item in enumerate(items):
        with inside(kind.__name__, f"[{i}]"):
            made.append(from_mapping(kind, item))
    return tuple(made)


def _as_span(low: float, high: float, value: object) -> object:
    value = as_tuples(value)
    pair = (value, value) if finite(value) else value
    return tuple(map(float, pair)) if isinstance(pair, tuple) and all(_in_range(v, low, high) for v in pair) else value


def _check_part(owner: object, f: dataclasses.Field[Any]) -> None:
    kind, value = f.metadata["kind"], getattr(owner, f.name)
    if not isinstance(value, kind) and not (value is None and f.default is None):
        none = ", or None" if f.default is None else ""
        raise refuse(owner, f.name, f"give {kind.__name__}(...) or a mapping of its fields{none}")


def _check_parts(owner: object, f: dataclasses.Field[Any]) -> None:
    kind, value = f.metadata["kind"], getattr(owner, f.name)
    if not isinstance(value, tuple) or not all(isinstance(item, kind) for item in value):
        raise refuse(owner, f.name, f"give a list of {kind.__name__}(...) or of mappings of its fields, () for none")


def _check_span(owner: object, f: dataclasses.Field[Any]) -> None:
    low, high = f.metadata["bounds"]
    value = getattr(owner, f.name)
    if value is None and f.default is None:
        return
    if not isinstance(value, tuple) or len(value) != 2 or not all(_in_range(one, low, high) for one in value):
        remedy = f"give a number from {low:g} to {high:g}, or a pair of them, a lowest and a highest"
        raise refuse(owner, f.name, remedy)
    if value[0] > value[1]:
        raise refuse(owner, f.name, "give the lowest first")


def _check_number(owner: object, f: dataclasses.Field[Any]) -> None:
    low, bound = f.metadata["bounds"]
    high = getattr(owner, bound) if isinstance(bound, str) else bound
    value = getattr(owner, f.name)
    if value is None and f.default is None:
        return
    if not (is_number(value) and is_number(high) and low <= value <= min(high, 1e300)):
        upper = f"{bound} = {high:g}" if isinstance(bound, str) and is_number(high) else f"{high:g}"
        remedy = f"give a finite number in [{low:g}, {upper}]{', or None' * (f.default is None)}"
        raise refuse(owner, f.name, remedy + _not_subnormal(value))


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
    return _in_range(value, max(low, -_LARGEST), min(high, _LARGEST))


def _in_range(value: Any, low: float = -_LARGEST, high: float = math.inf) -> bool:
    """Return whether it is a number within bounds, and finite or infinite as a float too."""
    return is_number(value) and low <= value <= high and (value <= _LARGEST or value == math.inf)
