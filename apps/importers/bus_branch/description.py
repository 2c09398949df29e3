"""A balanced grid as buses and branches in per unit, radial or meshed; every format is first read into this form.

Voltages are per unit of each bus's base. Impedances and admittances are per unit of the bus at the stated end, on one
base power. A branch is that of MATPOWER: an ideal transformer of ratio ``tap`` at its from end, followed by a series
impedance with an admittance to ground at each end.

References
----------
R. D. Zimmerman, C. E. Murillo-Sanchez, MATPOWER User's Manual, section 3.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Branch:
    """A line, transformer or the like between two buses, given by their rows.

    Attributes
    ----------
    kind, name
        What the source calls the element, such as ``"line"`` and ``"3"``.
    from_bus, to_bus
        Rows of its buses.
    z_pu
        Series impedance, per unit of the to bus.
    y_from_pu, y_to_pu
        Admittance to ground behind the ideal transformer and at the to bus, per unit of the to bus.
    tap
        Voltage at the from bus over the voltage behind the ideal transformer, each per unit.
    shift_deg
        Angle by which the voltage at the from bus leads the one behind the ideal transformer.
    rating_pu
        Largest current at the to end, per unit of the to bus; NaN where it is not known.
    from_closed, to_closed
        Whether the branch is connected at each end; one end alone leaves its admittances to ground.
    """

    kind: str
    name: str
    from_bus: int
    to_bus: int
    z_pu: complex
    y_from_pu: complex = 0j
    y_to_pu: complex = 0j
    tap: float = 1.0
    shift_deg: float = 0.0
    rating_pu: float = math.nan
    from_closed: bool = True
    to_closed: bool = True

    def reversed(self) -> Branch:
        """This branch as it is seen from its other end."""
        square = self.tap**2
        return replace(
            self,
            from_bus=self.to_bus,
            to_bus=self.from_bus,
            z_pu=self.z_pu * square,
            y_from_pu=self.y_to_pu / square,
            y_to_pu=self.y_from_pu / square,
            tap=1.0 / self.tap,
            shift_deg=-self.shift_deg,
            rating_pu=self.rating_pu / self.tap,
            from_closed=self.to_closed,
            to_closed=self.from_closed,
        )


@dataclass(frozen=True, slots=True)
class ClosedSwitch:
    """A switch without impedance that makes two buses one."""

    name: str
    from_bus: int
    to_bus: int


@dataclass(frozen=True, slots=True)
class Source:
    """An ideal voltage source."""

    kind: str
    name: str
    bus: int
    v_pu: float


@dataclass
class BusBranchGrid:
    """A balanced grid; arrays are over buses, shape (n_bus,).

    Attributes
    ----------
    name
        What the grid is called.
    base_mva
        Base power of the branches' impedances, MVA.
    buses
        Name of each bus.
    base_kv
        Line-to-line base voltage, kV.
    p_kw, q_kvar
        Constant power drawn, whatever the voltage; generation is negative.
    shunt_kw, shunt_kvar
        Constant admittance: power drawn and reactive power injected at 1 p.u. of the bus's own base.
    x, y
        Coordinates, NaN where none are known.
    branches, switches, sources
        What joins buses and what feeds them.
    """

    name: str
    base_mva: float
    buses: tuple[str, ...]
    base_kv: FloatArray
    p_kw: FloatArray
    q_kvar: FloatArray
    shunt_kw: FloatArray
    shunt_kvar: FloatArray
    x: FloatArray
    y: FloatArray
    branches: list[Branch] = field(default_factory=list)
    switches: list[ClosedSwitch] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)

    @property
    def n_bus(self) -> int:
        """Number of buses."""
        return len(self.buses)


def empty_grid(name: str, base_mva: float, buses: tuple[str, ...], base_kv: FloatArray) -> BusBranchGrid:
    """A grid of buses alone, where nothing is drawn and no coordinates are known."""
    n = len(buses)
    p_kw, q_kvar, shunt_kw, shunt_kvar = np.zeros((4, n))
    x, y = np.full((2, n), math.nan)
    base_kv = np.asarray(base_kv, dtype=np.float64)
    return BusBranchGrid(name, base_mva, buses, base_kv, p_kw, q_kvar, shunt_kw, shunt_kvar, x, y)
