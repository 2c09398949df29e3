"""Base of the component tables: columns of one length, and buses identified by text."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np

from dcgrid_env.grid.topology import FeederError

BusId = int | str
"""Types that identify a bus; it is stored as text."""


def bus_text(bus: object) -> str:
    """The text by which a bus is known; FeederError for what is neither text nor a whole number."""
    if isinstance(bus, str):
        return str(bus)
    if isinstance(bus, Integral) and not isinstance(bus, bool):
        return str(int(bus))
    raise FeederError(f"bus {bus!r} is neither text nor a whole number; name it by text such as '18'")


def buses_as_text(values: object) -> Any:
    """Return buses as a tuple of texts; values of other types unchanged, for the checks to refuse."""
    if not isinstance(values, list | tuple | np.ndarray):
        return values
    try:
        return tuple(map(bus_text, values))
    except (FeederError, TypeError):  # what is no bus; an array without a dimension
        return values


def bus_numbers(buses: Sequence[str]) -> tuple[int, ...] | None:
    """The whole numbers that the texts of all these buses are, written as Python writes them; None unless all are."""
    if all(re.fullmatch(r"0|-?[1-9][0-9]*", bus) for bus in buses):
        return tuple(map(int, buses))
    return None


@dataclass(frozen=True)
class Table:
    """Columns of one length, kept as tuples; those named ``bus`` or ``.._bus`` hold text.

    A column whose metadata say ``optional`` may be empty while others have rows: such a grid has no use for it.
    """

    def __post_init__(self) -> None:
        for column in dataclasses.fields(self):
            values = tuple(map(_as_tuple, getattr(self, column.name)))
            if column.name == "bus" or column.name.endswith("_bus"):
                values = tuple(map(bus_text, values))
            object.__setattr__(self, column.name, values)
            if len(values) != len(self) and (values or not column.metadata.get("optional")):
                raise FeederError(f"{type(self).__name__}: {len(values)} values of {column.name} for {len(self)} rows")

    def __len__(self) -> int:
        return len(getattr(self, dataclasses.fields(self)[0].name))


def optional_column() -> Any:
    """A column of a :class:`Table` that may be empty while others have rows."""
    return dataclasses.field(default=(), metadata={"optional": True})


def _as_tuple(value: object) -> Any:
    """A value of a cell, a matrix or the like as tuples of tuples."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(map(_as_tuple, value)) if isinstance(value, list | tuple) else value
