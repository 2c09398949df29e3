"""Component tables of a grid, which file formats read and write and from which a feeder is compiled.

Each table is a frozen set of columns of one length, one row per component, and every physical column has its unit in
its name. Buses are identified by text; whole numbers are converted to text. A phase is 1, 2 or 3 for a, b or c, 4 to 26
for other conductors with the letters d to z. It is 0 for the positive sequence, which describes a balanced grid. A
balanced grid uses source, node, line, load and shunt; a three-phase grid uses source, node and the tables of
``three_phase_tables``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.table import BusId, Table, bus_numbers, bus_text, buses_as_text, optional_column
from dcgrid_env.grid.three_phase_tables import (
    AdmittanceTable,
    CapacitorControlTable,
    CapacitorTable,
    CoreTable,
    Matrix,
    PhaseLineTable,
    PhaseLoadTable,
    RegulatorTable,
    SwitchTable,
    TransformerTable,
)

__all__ = [
    "AdmittanceTable",
    "BusId",
    "CapacitorControlTable",
    "CapacitorTable",
    "CoreTable",
    "LineTable",
    "LoadTable",
    "Network",
    "NodeTable",
    "PhaseLineTable",
    "PhaseLoadTable",
    "RatingTable",
    "RegulatorTable",
    "ShuntTable",
    "SourceTable",
    "SwitchTable",
    "TransformerTable",
    "balanced_network",
    "bus_numbers",
    "bus_text",
    "buses_as_text",
    "summed_at_nodes",
]


@dataclass(frozen=True)
class NodeTable(Table):
    """One row for each phase of each bus, the phases of a bus adjacent."""

    bus: Sequence[str] = ()
    phase: Sequence[int] = ()
    x: Sequence[float] = ()
    """Coordinates of the bus in the one-line diagram, without unit; NaN where none are published."""
    y: Sequence[float] = ()
    base_kv_ln: Sequence[float] = optional_column()
    """Line-to-neutral base voltage of the bus, kV; of three-phase grids alone."""
    base_kv: Sequence[float] = optional_column()
    """Line-to-line base voltage of the bus, kV, for information; of balanced grids alone. NaN is the source's."""
    voltage_ratio: Sequence[float] = optional_column()
    """Voltage of the bus, per unit of its base, over its voltage referred to the source, p.u.; balanced grids only.
    It differs from 1 behind transformers with an off-nominal ratio. NaN is 1."""


@dataclass(frozen=True)
class LineTable(Table):
    """One row for each line, its series impedance in the positive sequence; zero is a closed switch."""

    from_bus: Sequence[str] = ()
    to_bus: Sequence[str] = ()
    r_ohm: Sequence[float] = ()
    x_ohm: Sequence[float] = ()
    """Impedances are referred to the source's base voltage by the actual ratios of the transformers between."""
    rating_a: Sequence[float] = optional_column()
    """Ampacity, A, referred like the impedances; NaN where it is not known."""


@dataclass(frozen=True)
class ShuntTable(Table):
    """One row for each capacitor or shunt admittance."""

    bus: Sequence[str] = ()
    phase: Sequence[int] = ()
    capacitor_kvar: Sequence[float] = ()
    """Reactive injection at any voltage."""
    shunt_kw: Sequence[float] = optional_column()
    """Draw of a constant admittance at a referred voltage of 1 p.u.; it goes with the voltage's square."""
    shunt_kvar: Sequence[float] = optional_column()
    """Injection of a constant admittance at a referred voltage of 1 p.u.; it goes with the voltage's square."""


@dataclass(frozen=True)
class LoadTable(Table):
    """One row for each load; consumption is positive."""

    bus: Sequence[str] = ()
    phase: Sequence[int] = ()
    p_kw: Sequence[float] = ()
    q_kvar: Sequence[float] = ()


@dataclass(frozen=True)
class SourceTable(Table):
    """One row for each ideal source: line-to-line base voltage and the voltage that it keeps.

    The last three columns are of three-phase grids alone, where the ideal source feeds the bus through an impedance.
    """

    bus: Sequence[str] = ()
    base_kv: Sequence[float] = ()
    v_pu: Sequence[float] = ()
    angle_deg: Sequence[float] = optional_column()
    """Angle of phase a; b lags it by 120 degrees, c by 240."""
    r_ohm: Sequence[Matrix] = optional_column()
    x_ohm: Sequence[Matrix] = optional_column()


@dataclass(frozen=True)
class RatingTable(Table):
    """One row for each element and season with further ratings, in the unit of the element's rating column.

    The rating column is the normal rating without a season, so a row without a season has an emergency rating alone.
    """

    element: Sequence[str] = ()
    """Kind and name, such as ``"line l1"`` or ``"transformer xfm1"``; ``"branch FROM-TO"`` of balanced grids."""
    season: Sequence[str] = ()
    """Name such as ``"winter"``; empty for all seasons."""
    normal: Sequence[float] = ()
    """Rating of continuous operation; NaN where it is not known."""
    emergency: Sequence[float] = ()
    """Rating for the hours after an outage; NaN where it is not known."""


@dataclass(frozen=True)
class Network:
    """A grid as tables. Nothing is checked here but the columns' lengths: see ``Feeder.from_network`` and
    ``ThreePhaseFeeder.from_network``."""

    name: str
    source: SourceTable
    node: NodeTable
    line: LineTable = field(default_factory=LineTable)
    load: LoadTable = field(default_factory=LoadTable)
    shunt: ShuntTable = field(default_factory=ShuntTable)
    phase_line: PhaseLineTable = field(default_factory=PhaseLineTable)
    switch: SwitchTable = field(default_factory=SwitchTable)
    transformer: TransformerTable = field(default_factory=TransformerTable)
    regulator: RegulatorTable = field(default_factory=RegulatorTable)
    phase_load: PhaseLoadTable = field(default_factory=PhaseLoadTable)
    capacitor: CapacitorTable = field(default_factory=CapacitorTable)
    capacitor_control: CapacitorControlTable = field(default_factory=CapacitorControlTable)
    core: CoreTable = field(default_factory=CoreTable)
    admittance: AdmittanceTable = field(default_factory=AdmittanceTable)
    rating: RatingTable = field(default_factory=RatingTable)
    frequency_hz: float = 60.0
    """Frequency at which reactances and susceptances hold."""
    source_of_facts: str = ""
    """Source of the figures; the power flow does not use it."""


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
    shunt_kw: Sequence[float] | None = None,
    shunt_kvar: Sequence[float] | None = None,
) -> Network:
    """Tables of a balanced grid from columns over its buses; a load, capacitor or shunt of 0 gets no row."""
    loaded = [i for i in range(len(nodes)) if not (_is_zero(p_kw[i]) and _is_zero(q_kvar[i]))]
    admittances = [values for values in (shunt_kw, shunt_kvar) if values is not None]
    shunts = (capacitor_kvar, *admittances)
    shunted = [i for i in range(len(nodes)) if not all(_is_zero(values[i]) for values in shunts)]

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
        shunt=ShuntTable(
            taken(nodes.bus, shunted),
            taken(nodes.phase, shunted),
            taken(capacitor_kvar, shunted),
            () if shunt_kw is None else taken(shunt_kw, shunted),
            () if shunt_kvar is None else taken(shunt_kvar, shunted),
        ),
    )


def summed_at_nodes(node: NodeTable, buses: Sequence[str], values: Sequence[float]) -> NDArray[np.float64]:
    """Sum of a component's values at the node of each bus, in the order of the nodes, shape (n_node,)."""
    row = {bus: i for i, bus in enumerate(node.bus)}
    total = np.zeros(len(node))
    for bus, value in zip(buses, values, strict=True):
        total[row[bus]] += value
    return total


def _is_zero(value: object) -> bool:
    return not isinstance(value, bool | str) and value is not None and bool(value == 0)
