"""The nodes and legs of a balanced feeder: one of each at every bus, for the positive sequence."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.topology import FeederError

IntArray = NDArray[np.intp]


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


class OneNodeABus:
    """Mixed into ``Feeder``; the same names mean the same on a three-phase feeder."""

    name: Any  # a str, and a tuple of str: fields of one feeder, properties of many
    bus_ids: Any

    @property
    def n_node(self) -> int:
        """Number of nodes. A node is a phase of a bus; a balanced feeder has one at each bus, in ``bus_ids``' order."""
        return len(self.bus_ids)

    @property
    def node_ids(self) -> tuple[str, ...]:
        """Name of each node: its bus's."""
        return self.bus_ids

    @cached_property
    def node_bus(self) -> IntArray:
        """Position in ``bus_ids`` of each node's bus, shape (n_node,)."""
        return _read_only(np.arange(self.n_node, dtype=np.intp))

    @cached_property
    def node_phase(self) -> IntArray:
        """Phase of each node, shape (n_node,): always 0, the positive sequence of a balanced feeder."""
        return _read_only(np.zeros(self.n_node, dtype=np.intp))

    @cached_property
    def source_nodes(self) -> IntArray:
        """Nodes of the substation, where the voltage is given."""
        return _read_only(np.flatnonzero(self.node_bus == 0))

    @cached_property
    def load_nodes(self) -> IntArray:
        """All other nodes, where the voltage follows from the loads: those that voltages are judged at."""
        return _read_only(np.flatnonzero(self.node_bus != 0))

    @cached_property
    def load_slice(self) -> slice:
        """``load_nodes`` as a slice of an axis over nodes, which takes them without a copy: the source's come first."""
        return slice(len(self.source_nodes), None)

    @property
    def n_leg(self) -> int:
        """Number of legs, at which power is drawn: on a balanced feeder the nodes."""
        return self.n_node

    @property
    def first_device_leg(self) -> int:
        """Leg ``first_device_leg + node`` is where a device at that node draws and injects."""
        return 0

    @property
    def leg_node(self) -> IntArray:
        """Node of each leg, shape (n_leg,)."""
        return self.node_bus

    def nodes_at(self, position: int, phases: str | None = None) -> tuple[int, ...]:
        """The nodes of the bus at a position in ``bus_ids``; FeederError for phases: a balanced feeder has none."""
        if phases is not None:
            raise FeederError(f"feeder {self.name!r} is balanced and has no phases {phases!r}; leave the phases out")
        return (position,)
