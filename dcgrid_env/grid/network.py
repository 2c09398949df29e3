"""The component tables of a grid: what a file format reads and writes, and what a feeder is compiled from.

Each table is a frozen set of columns of one length, one row a component, and every physical column has its unit in its
name. Buses are known by text; whole numbers may be given and become text. A phase is 1, 2 or 3 for a, b or c, and 0 for
the positive sequence, by which a balanced grid is described.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.topology import FeederError

BusId = int | str
"""What a bus may be given as; it is kept as text."""


def bus_text(bus: Any) -> str:
    """The text by which a bus is known; FeederError for what is neither text nor a whole number."""
    if isinstance(bus, str):
        return str(bus)
    if isinstance(bus, Integral) and not isinstance(bus, bool):
        return str(int(bus))
    raise FeederError(f"bus {bus!r} is neither text nor a whole number; name it by text such as '18'")


def buses_as_text(values: Any) -> Any:
    """Buses as a tuple of texts; what is no sequence of texts and whole numbers as it is, to be refused by checks."""
    if not isinstance(values, list | tuple | np.ndarray):
        return values
    try:
        return tuple(map(bus_text, values))
    except FeederError:
        return values


def bus_numbers(buses: Sequence[str]) -> tuple[int, ...] | None:
    """The whole numbers that the texts of all these buses are, written as Python writes them; None unless all are."""
    if all(re.fullmatch(r"0|-?[1-9][0-9]*", bus) for bus in buses):
        return tuple(map(int, buses))
    return None


@dataclass(frozen=True)
class _Table:
    """Columns of one length, kept as tuples; those named ``bus`` or ``.._bus`` hold text."""

    def __post_init__(self) -> None:
        for column in dataclasses.fields(self):
            values = tuple(getattr(self, column.name))
            if column.name == "bus" or column.name.endswith("_bus"):
                values = tuple(map(bus_text, values))
            object.__setattr__(self, column.name, values)
            if len(values) != len(self):
                raise FeederError(f"{type(self).__name__}: {len(values)} values of {column.name} for {len(self)} rows")

    def __len__(self) -> int:
        return len(getattr(self, dataclasses.fields(self)[0].name))


@dataclass(frozen=True)
class NodeTable(_Table):
    """One row for each phase of each bus, the phases of a bus adjacent."""

    bus: Sequence[str] = ()
    phase: Sequence[int] = ()
    x: Sequence[float] = ()
    """Coordinates of the bus in the one-line diagram, without unit; NaN where none are published."""
    y: Sequence[float] = ()


@dataclass(frozen=True)
class LineTable(_Table):
    """One row for each line, its series impedance in the positive sequence; zero is a closed switch."""

    from_bus: Sequence[str] = ()
    to_bus: Sequence[str] = ()
    r_ohm: Sequence[float] = ()
    x_ohm: Sequence[float] = ()


@dataclass(frozen=True)
class TransformerTable(_Table):
    """One row for each transformer between two voltages, line to line, its impedance on its own rating."""

    from_bus: Sequence[str] = ()
    to_bus: Sequence[str] = ()
    from_kv: Sequence[float] = ()
    to_kv: Sequence[float] = ()
    rated_kva: Sequence[float] = ()
    r_pu: Sequence[float] = ()
    x_pu: Sequence[float] = ()


@dataclass(frozen=True)
class RegulatorTable(_Table):
    """One row for each phase of each voltage regulator; its ratio is 1 + ``step_pu`` times the tap."""

    from_bus: Sequence[str] = ()
    to_bus: Sequence[str] = ()
    phase: Sequence[int] = ()
    step_pu: Sequence[float] = ()
    lowest_tap: Sequence[int] = ()
    highest_tap: Sequence[int] = ()


@dataclass(frozen=True)
class ShuntTable(_Table):
    """One row for each capacitor; injection is positive."""

    bus: Sequence[str] = ()
    phase: Sequence[int] = ()
    capacitor_kvar: Sequence[float] = ()


@dataclass(frozen=True)
class LoadTable(_Table):
    """One row for each load; consumption is positive."""

    bus: Sequence[str] = ()
    phase: Sequence[int] = ()
    p_kw: Sequence[float] = ()
    q_kvar: Sequence[float] = ()


@dataclass(frozen=True)
class SourceTable(_Table):
    """One row for each ideal source: line-to-line base voltage and the voltage that it keeps."""

    bus: Sequence[str] = ()
    base_kv: Sequence[float] = ()
    v_pu: Sequence[float] = ()


@dataclass(frozen=True)
class Network:
    """A grid as tables. Nothing is checked here but the columns' lengths: see ``Feeder.from_network``."""

    name: str
    source: SourceTable
    node: NodeTable
    line: LineTable = field(default_factory=LineTable)
    load: LoadTable = field(default_factory=LoadTable)
    shunt: ShuntTable = field(default_factory=ShuntTable)
    transformer: TransformerTable = field(default_factory=TransformerTable)
    regulator: RegulatorTable = field(default_factory=RegulatorTable)


def balanced_network(
    name: str,
    *,
    base_kv: float,
    substation: BusId,
    v0_pu: float,
    nodes: NodeTable,
    p_kw: Sequence[float],
    q_kvar: Sequence[float],
    capacitor_kvar: Sequence[float],
    lines: LineTable,
) -> Network:
    """Tables of a balanced grid from columns over its buses; a load or capacitor of 0 gets no row."""
    loaded = [i for i in range(len(nodes)) if not (_is_zero(p_kw[i]) and _is_zero(q_kvar[i]))]
    shunted = [i for i in range(len(nodes)) if not _is_zero(capacitor_kvar[i])]

    def taken(values: Sequence[Any], rows: list[int]) -> tuple[Any, ...]:
        return tuple(values[i] for i in rows)

    return Network(
        name=name,
        source=SourceTable(bus=(substation,), base_kv=(base_kv,), v_pu=(v0_pu,)),  # pyright: ignore[reportArgumentType]
        node=nodes,
        line=lines,
        load=LoadTable(
            taken(nodes.bus, loaded), taken(nodes.phase, loaded), taken(p_kw, loaded), taken(q_kvar, loaded)
        ),
        shunt=ShuntTable(taken(nodes.bus, shunted), taken(nodes.phase, shunted), taken(capacitor_kvar, shunted)),
    )


def summed_at_nodes(node: NodeTable, buses: Sequence[str], values: Sequence[float]) -> NDArray[np.float64]:
    """Sum of a component's values at the node of each bus, in the order of the nodes, shape (n_node,)."""
    row = {bus: i for i, bus in enumerate(node.bus)}
    total = np.zeros(len(node))
    for bus, value in zip(buses, values, strict=True):
        total[row[bus]] += value
    return total


def _is_zero(value: Any) -> bool:
    return not isinstance(value, bool | str) and value is not None and bool(value == 0)
