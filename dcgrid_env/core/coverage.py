"""What a fast path covers: the fields of records that it takes into account.

A fast path repeats part of the general path in fewer operations, so it knows only what was there when it was written.
Its coverage lists this. Everything else is refused, and the general path is taken. Refused are fields that are not
listed, unless they have their default, and classes that are not listed, such as subclasses. A class is also refused if
one of its functions was replaced.

    COVERED = Coverage({Sensing: "noise_pu delay_steps", Cost: "weights* band_pu"})
    COVERED.includes(scenario.sensing, scenario.cost)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import NoneType
from typing import Any

import numpy as np

_PLAIN = {NoneType, bool, int, float, str, np.ndarray}
"""Types of values without fields."""


class Coverage:
    """Fields that a fast path covers, by the class of the record.

    Parameters
    ----------
    settings
        Covered fields of dataclasses, which are fixed before an episode. A listed field may have any value. Records in
        it are checked too, unless its name ends in ``*``. Other fields must have their default.
    arrays
        Fields of named tuples of arrays, which change in each step. All their fields must be listed.
    """

    def __init__(self, settings: Mapping[type[Any], str], arrays: Mapping[type[Any], str] | None = None):
        self._settings = {kind: _listed(names) for kind, names in settings.items()}
        self._arrays = {kind: set(names.split()) for kind, names in (arrays or {}).items()}

    def includes(self, *values: Any) -> bool:
        """Return whether the fast path covers these records, or tuples of them, and all that they contain."""
        return self.first_unknown(*values) is None

    def first_unknown(self, *values: Any) -> str | None:
        """Return the first class, or field of a class, that the fast path does not cover; None if it covers all."""
        for kind, listed in self._arrays.items():
            for name in kind._fields:
                if name not in listed:
                    return f"{kind.__name__}.{name}"
        return self._unknown_in(values)

    def _unknown_in(self, value: Any) -> str | None:
        kind = type(value)
        if kind in _PLAIN or isinstance(value, np.generic):
            return None
        if kind is tuple:
            rest = () if _PLAIN.issuperset(map(type, value)) else value
            return next(filter(None, map(self._unknown_in, rest)), None)
        listed = self._settings.get(kind)
        if listed is None or not is_as_written(value):
            return kind.__name__
        for field in dataclasses.fields(value):
            is_checked = listed.get(field.name)
            if is_checked is None and not _is_default(value, field):
                return f"{kind.__name__}.{field.name}"
            if is_checked and (unknown := self._unknown_in(getattr(value, field.name))):
                return unknown
        return None


def _listed(names: str) -> dict[str, bool]:
    """Return for each covered field whether the records in it are checked."""
    return {name.removesuffix("*"): not name.endswith("*") for name in names.split()}


def _is_default(record: Any, field: dataclasses.Field[Any]) -> bool:
    made = field.default_factory
    default = field.default if made is dataclasses.MISSING else made()
    return alike(getattr(record, field.name), default)


def is_as_written(value: Any) -> bool:
    """Return whether a class and its instance have the functions of the class's source, none replaced or added."""
    kind, of_instance = type(value), vars(value)
    for name, member in vars(kind).items():
        if name.startswith("__"):
            continue
        function = getattr(member, "fget", None) or getattr(member, "func", None) or getattr(member, "__func__", member)
        if not callable(function):
            continue
        code = getattr(function, "__code__", None)
        if code is None or code.co_qualname != f"{kind.__qualname__}.{name}":
            return False
        if function is member and name in of_instance:
            return False
    return True


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
