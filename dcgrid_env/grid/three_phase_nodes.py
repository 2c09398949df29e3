"""The buses and nodes of a three-phase feeder: their names, order, phases, bases and places."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.network import BusId, Network, bus_text
from dcgrid_env.grid.three_phase_tree import Tree, three_phase_tree
from dcgrid_env.grid.topology import DepthFirst, FeederError, depth_first, listed

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]


def read_only(values: object, dtype: Any = np.float64) -> Any:
    """The values as an array that cannot be written to."""
    array = np.array(values, dtype)
    array.flags.writeable = False
    return array


class PhaseNodes:
    """Mixed into ``ThreePhaseFeeder``: what follows from its tables' buses and branches alone."""

    network: Network

    @property
    def name(self) -> str:
        """The feeder's name."""
        return self.network.name

    @cached_property
    def _tree(self) -> Tree:
        return three_phase_tree(self.network)

    @property
    def bus_ids(self) -> tuple[str, ...]:
        """Bus names, as text, depth first from the source bus."""
        return self._tree.bus_ids

    @property
    def bus_phases(self) -> tuple[str, ...]:
        """The phases of each bus, a text such as ``"abc"`` or ``"b"``."""
        return self._tree.phases

    @property
    def n_bus(self) -> int:
        """Number of buses, the source bus among them."""
        return len(self.bus_ids)

    @property
    def n_branch(self) -> int:
        """Number of branches, one for each bus but the source bus."""
        return len(self.bus_ids) - 1

    @cached_property
    def n_node(self) -> int:
        """Number of nodes: the phases of all buses."""
        return sum(map(len, self.bus_phases))

    @cached_property
    def parent(self) -> IntArray:
        """Position in ``bus_ids`` of the bus at the sending end of branch k, shape (n_branch,)."""
        return read_only(self._tree.parent, np.intp)

    @cached_property
    def depth_first(self) -> DepthFirst:
        """The buses in depth-first order from the source bus, which is the order they have, and their parents."""
        return depth_first(self.parent)

    @cached_property
    def first_node(self) -> IntArray:
        """First node of each bus, and ``n_node`` at the end, shape (n_bus + 1,)."""
        return read_only(np.cumsum([0, *map(len, self.bus_phases)]), np.intp)

    @cached_property
    def node_bus(self) -> IntArray:
        """Position in ``bus_ids`` of each node's bus, shape (n_node,)."""
        return read_only(np.repeat(np.arange(self.n_bus), np.diff(self.first_node)), np.intp)

    @cached_property
    def node_phase(self) -> IntArray:
        """Phase of each node, shape (n_node,): 1, 2, 3 for a, b, c."""
        return read_only(["abc".index(phase) + 1 for phases in self.bus_phases for phase in phases], np.intp)

    @cached_property
    def node_ids(self) -> tuple[str, ...]:
        """Name of each node: its bus's, a dot, and its phase."""
        return tuple(f"{bus}.{p}" for bus, phases in zip(self.bus_ids, self.bus_phases, strict=True) for p in phases)

    @cached_property
    def node_parent(self) -> IntArray:
        """Node of the same phase at the bus that feeds each node's, shape (n_node,); -1 at the source bus."""
        found = [-1] * len(self.bus_phases[0])
        for i in range(1, self.n_bus):
            sender = self.parent[i - 1]
            found += [self.first_node[sender] + self.bus_phases[sender].index(p) for p in self.bus_phases[i]]
        return read_only(found, np.intp)

    @cached_property
    def source_nodes(self) -> IntArray:
        """Nodes of the source bus, whose voltage varies because the ideal source is behind an impedance."""
        return read_only(np.flatnonzero(self.node_bus == 0), np.intp)

    @cached_property
    def load_nodes(self) -> IntArray:
        """All other nodes: those that voltages are judged at."""
        return read_only(np.flatnonzero(self.node_bus != 0), np.intp)

    @cached_property
    def load_slice(self) -> slice:
        """``load_nodes`` as a slice of an axis over nodes, which takes them without a copy: the source's come first."""
        return slice(len(self.source_nodes), None)

    def index(self, bus: BusId) -> int:
        """Position of a bus, given as text or a whole number, in ``bus_ids``; FeederError where there is none."""
        try:
            return self._index[bus_text(bus)]
        except KeyError:
            raise FeederError(
                f"feeder {self.name!r} has no bus {bus!r}; its buses are {listed(self.bus_ids)}"
            ) from None

    def nodes_of(self, bus: BusId, phases: str | None = None) -> tuple[int, ...]:
        """The nodes of a bus, or of some of its phases; FeederError for a bus or a phase that there is not."""
        return self.nodes_at(self.index(bus), phases)

    def nodes_at(self, position: int, phases: str | None = None) -> tuple[int, ...]:
        """The nodes of the bus at a position in ``bus_ids``, or of some of its phases, in their order."""
        there, first = self.bus_phases[position], int(self.first_node[position])
        for phase in phases or ():
            if phase not in there:
                bus = self.bus_ids[position]
                raise FeederError(
                    f"feeder {self.name!r}: bus {bus!r} has the phases {there}, not {phase}; choose these"
                )
        return tuple(first + there.index(phase) for phase in phases or there)

    @cached_property
    def _index(self) -> dict[str, int]:
        return {bus: i for i, bus in enumerate(self.bus_ids)}

    @cached_property
    def _nodes_by_phase(self) -> dict[str, dict[str, int]]:
        return {
            bus: {phase: int(self.first_node[i]) + k for k, phase in enumerate(self.bus_phases[i])}
            for i, bus in enumerate(self.bus_ids)
        }

    @property
    def _bases(self) -> dict[str, float]:
        return dict(zip(self.bus_ids, self.base_kv_ln.tolist(), strict=True))

    def _by_bus(self, values: Sequence[float]) -> FloatArray:
        of_bus = dict(zip(self.network.node.bus, values, strict=True))
        return read_only([of_bus[bus] for bus in self.bus_ids])

    @cached_property
    def base_kv_ln(self) -> FloatArray:
        """Line-to-neutral base voltage of each bus, kV, shape (n_bus,)."""
        return self._by_bus(self.network.node.base_kv_ln)

    @cached_property
    def x(self) -> FloatArray:
        """Coordinate of each bus in the one-line diagram, shape (n_bus,), NaN where none is published."""
        return self._by_bus(self.network.node.x)

    @cached_property
    def y(self) -> FloatArray:
        """Coordinate of each bus in the one-line diagram, shape (n_bus,), NaN where none is published."""
        return self._by_bus(self.network.node.y)
