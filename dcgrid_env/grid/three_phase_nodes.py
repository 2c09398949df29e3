"""The buses and nodes of a three-phase feeder: their names, order, phases, bases and places."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.network import BusId, Network, bus_text
from dcgrid_env.grid.three_phase_tables import LETTERS
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

    @property
    def is_radial(self) -> bool:
        """Whether one branch brings each bus all of its phases, so that the sweep solves the power flow."""
        return self._tree.is_radial

    @cached_property
    def _nodes(self) -> tuple[tuple[int, str], ...]:
        """Position of the bus and letter of each node: the source bus's, other conductors than phases, and the rest."""
        nodes = [(i, letter) for i, letters in enumerate(self.bus_phases) for letter in letters]
        return tuple(sorted(nodes, key=lambda node: 0 if node[0] == 0 else 1 if node[1] > "c" else 2))

    @cached_property
    def first_node(self) -> IntArray:
        """First node of each bus of a radial feeder, and ``n_node`` at the end, shape (n_bus + 1,)."""
        return read_only(np.cumsum([0, *map(len, self.bus_phases)]), np.intp)

    @cached_property
    def node_bus(self) -> IntArray:
        """Position in ``bus_ids`` of each node's bus, shape (n_node,)."""
        return read_only([bus for bus, _ in self._nodes], np.intp)

    @cached_property
    def node_phase(self) -> IntArray:
        """Phase of each node, shape (n_node,): 1, 2, 3 for a, b, c, and more for other conductors."""
        return read_only([LETTERS.index(letter) + 1 for _, letter in self._nodes], np.intp)

    @cached_property
    def node_ids(self) -> tuple[str, ...]:
        """Name of each node: its bus's, a dot, and its phase."""
        return tuple(f"{self.bus_ids[bus]}.{letter}" for bus, letter in self._nodes)

    @cached_property
    def source_nodes(self) -> IntArray:
        """Nodes of the source bus, whose voltage varies because the ideal source is behind an impedance."""
        return read_only(np.flatnonzero(self.node_bus == 0), np.intp)

    @cached_property
    def load_nodes(self) -> IntArray:
        """The phases of all other buses: the nodes that voltages are judged at. Other conductors are not judged."""
        return read_only(np.arange(self.load_slice.start, self.n_node), np.intp)

    @cached_property
    def load_slice(self) -> slice:
        """``load_nodes`` as a slice of an axis over nodes, which takes them without a copy: the others come first."""
        return slice(sum(bus == 0 or letter > "c" for bus, letter in self._nodes), None)

    def index(self, bus: BusId) -> int:
        """Position of a bus, given as text or a whole number, in ``bus_ids``; FeederError where there is none."""
        try:
            return self._index[bus_text(bus)]
        except KeyError:
            raise FeederError(
                f"feeder {self.name!r} has no bus {bus!r}; its buses are {listed(self.bus_ids)}"
            ) from None

    def nodes_of(self, bus: BusId, phases: str | None = None) -> tuple[int, ...]:
        """The nodes of a bus's phases, or of some of them; FeederError for a bus or a phase that there is not."""
        return self.nodes_at(self.index(bus), phases)

    def nodes_at(self, position: int, phases: str | None = None) -> tuple[int, ...]:
        """The nodes of the phases of the bus at a position in ``bus_ids``, or of some of its conductors, in order."""
        bus, there = self.bus_ids[position], self.bus_phases[position]
        for phase in phases or ():
            if phase not in there:
                raise FeederError(
                    f"feeder {self.name!r}: bus {bus!r} has the phases {there}, not {phase}; choose these"
                )
        phases = phases or "".join(letter for letter in there if letter <= "c")
        return tuple(self._nodes_by_phase[bus][phase] for phase in phases)

    @cached_property
    def _index(self) -> dict[str, int]:
        return {bus: i for i, bus in enumerate(self.bus_ids)}

    @cached_property
    def _nodes_by_phase(self) -> dict[str, dict[str, int]]:
        by_bus: dict[str, dict[str, int]] = {bus: {} for bus in self.bus_ids}
        for node, (bus, letter) in enumerate(self._nodes):
            by_bus[self.bus_ids[bus]][letter] = node
        return by_bus

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
