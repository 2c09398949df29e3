"""What the power flow takes of a balanced feeder: its branches and shunts per unit, and its buses depth first.

Per unit is used inside the power flow only. Power has one base for every feeder, so figures of feeders can be compared.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.topology import DepthFirst, depth_first

FloatArray = NDArray[np.float64]

S_BASE_KVA = 1000.0
"""Base power, kVA (three-phase)."""


def impedance_base_ohm(base_kv: float) -> float:
    """Impedance base, ohm per phase, of a feeder whose line-to-line base voltage is ``base_kv``."""
    return base_kv**2 / (S_BASE_KVA / 1000.0)


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


class PerUnit:
    """Mix-in of ``Feeder`` with quantities derived from its fields, computed on first access."""

    base_kv: float
    bus_ids: tuple[str, ...]
    parent: NDArray[np.intp]
    loop_ends: NDArray[np.intp] | None
    r_ohm: FloatArray
    x_ohm: FloatArray
    shunt_kw: FloatArray | None
    shunt_kvar: FloatArray | None

    @cached_property
    def r_pu(self) -> FloatArray:
        """Series resistance of each branch, per unit, shape (n_branch,)."""
        return _read_only(self.r_ohm / impedance_base_ohm(self.base_kv))

    @cached_property
    def x_pu(self) -> FloatArray:
        """Series reactance of each branch, per unit, shape (n_branch,)."""
        return _read_only(self.x_ohm / impedance_base_ohm(self.base_kv))

    @cached_property
    def shunts_pu(self) -> FloatArray | None:
        """Active draw and reactive injection of the buses' shunts at 1 p.u., per unit, shape (2, n_bus), or None."""
        if self.shunt_kw is None and self.shunt_kvar is None:
            return None
        shunts = (np.zeros(len(self.bus_ids)) if shunt is None else shunt for shunt in (self.shunt_kw, self.shunt_kvar))
        return _read_only(np.stack(tuple(shunts)) / S_BASE_KVA)

    @property
    def from_bus(self) -> NDArray[np.intp]:
        """Index of the bus at the sending end of branch k, shape (n_branch,)."""
        return self.parent if self.loop_ends is None else _read_only(np.append(self.parent, self.loop_ends[:, 0]))

    @property
    def to_bus(self) -> NDArray[np.intp]:
        """Index of the bus at the receiving end of branch k, shape (n_branch,)."""
        receiving = np.arange(1, len(self.bus_ids), dtype=np.intp)
        return _read_only(receiving if self.loop_ends is None else np.append(receiving, self.loop_ends[:, 1]))

    @cached_property
    def depth_first(self) -> DepthFirst:
        """Buses of the tree in depth-first order from the substation, and the position of each in that order."""
        return depth_first(self.parent)

    @cached_property
    def path(self) -> FloatArray:
        """0/1 matrix, shape (n_bus, n_bus - 1): 1 where branch k of the tree lies between bus i and the substation."""
        path = np.zeros((len(self.bus_ids), len(self.bus_ids) - 1))
        for j in self.depth_first.order[1:]:
            path[j] = path[self.parent[j - 1]]
            path[j, j - 1] = 1.0
        return _read_only(path)
