"""An unbalanced three-phase radial feeder: buses of one to three phases, branches, legs. Frozen and checked once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.cache import fields_alone
from dcgrid_env.grid.formats.three_phase_folder import read_folder, write_folder
from dcgrid_env.grid.network import BusId, Network, bus_text
from dcgrid_env.grid.three_phase_checks import check_three_phase
from dcgrid_env.grid.three_phase_legs import Legs, capacitor_legs, load_legs
from dcgrid_env.grid.three_phase_matrices import Branches, branches_of
from dcgrid_env.grid.three_phase_tree import Tree, three_phase_tree
from dcgrid_env.grid.topology import FeederError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

__all__ = ["ThreePhaseFeeder"]


def _read_only(values: Any, dtype: Any = np.float64) -> Any:
    array = np.array(values, dtype)
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class ThreePhaseFeeder:
    """A radial feeder of one, two and three phases. A *node* is a phase of a bus, the phases of a bus adjacent.

    Make one with :meth:`from_network`, :meth:`from_csv` or :func:`dcgrid_env.load_feeder`: they check it. Every array
    over buses follows ``bus_ids``, which run depth first from the source bus; branch ``k`` feeds bus ``k + 1``.

    What draws is a *leg*, from a node to another or to ground. First come the legs of the loads, then one leg from
    each node to ground, where devices draw and inject constant power at any voltage; capacitors are not among them.

    Attributes
    ----------
    network
        The component tables that it is compiled from; all else follows from them.
    """

    network: Network

    @classmethod
    def from_network(cls, network: Network) -> ThreePhaseFeeder:
        """Check component tables and compile them.

        Raises
        ------
        FeederError
            Naming the component, the field and the value: a cell that cannot be, a loop, an island, a transformer
            that is fed from its secondary.
        """
        check_three_phase(network)
        feeder = cls(network)
        _ = feeder.branches
        return feeder

    def to_network(self) -> Network:
        """The component tables of this feeder, from which :meth:`from_network` makes the same feeder again."""
        return self.network

    @classmethod
    def from_csv(cls, folder: str | Path) -> ThreePhaseFeeder:
        """Read a feeder of your own from a folder of tables: see ``dcgrid_env.grid.formats.three_phase_folder``.

        Raises
        ------
        FeederError
            Naming the file, the row and the field, or the component, the field and the value.
        """
        feeder = cls.from_network(read_folder(Path(folder)))
        feeder.__dict__["_folder"] = Path(folder).absolute()  # beside the fields, which are what the feeder is
        return feeder

    @property
    def folder(self) -> Path | None:
        """Folder that it was read from; None for a feeder made otherwise, or taken out of a pickle."""
        return self.__dict__.get("_folder")

    def to_csv(self, folder: str | Path) -> None:
        """Write the files that :meth:`from_csv` reads; it then gives the same feeder, to the bit."""
        write_folder(self.network, Path(folder))

    def __deepcopy__(self, memo: dict[int, Any]) -> ThreePhaseFeeder:
        return self  # frozen: a copy shares it

    def __getstate__(self) -> dict[str, Any]:
        return fields_alone(self)

    @property
    def name(self) -> str:
        """The feeder's name."""
        return self.network.name

    @property
    def v0_pu(self) -> float:
        """Voltage of the ideal source behind the source's impedance, p.u."""
        return float(self.network.source.v_pu[0])

    @cached_property
    def source_angle_deg(self) -> FloatArray:
        """Angles of the ideal source's phases a, b, c, shape (3,)."""
        return _read_only(self.network.source.angle_deg[0] - np.array([0.0, 120.0, 240.0]))

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
        return _read_only(self._tree.parent, np.intp)

    @cached_property
    def first_node(self) -> IntArray:
        """First node of each bus, and ``n_node`` at the end, shape (n_bus + 1,)."""
        return _read_only(np.cumsum([0, *map(len, self.bus_phases)]), np.intp)

    @cached_property
    def node_bus(self) -> IntArray:
        """Position in ``bus_ids`` of each node's bus, shape (n_node,)."""
        return _read_only(np.repeat(np.arange(self.n_bus), np.diff(self.first_node)), np.intp)

    @cached_property
    def node_phase(self) -> IntArray:
        """Phase of each node, shape (n_node,): 1, 2, 3 for a, b, c."""
        return _read_only(["abc".index(phase) + 1 for phases in self.bus_phases for phase in phases], np.intp)

    @cached_property
    def node_parent(self) -> IntArray:
        """Node of the same phase at the bus that feeds each node's, shape (n_node,); -1 at the source bus."""
        found = [-1] * len(self.bus_phases[0])
        for i in range(1, self.n_bus):
            sender = self.parent[i - 1]
            found += [self.first_node[sender] + self.bus_phases[sender].index(p) for p in self.bus_phases[i]]
        return _read_only(found, np.intp)

    @cached_property
    def source_nodes(self) -> IntArray:
        """Nodes of the source bus. Its voltage is not held: the ideal source stands behind an impedance."""
        return _read_only(np.flatnonzero(self.node_bus == 0), np.intp)

    @cached_property
    def load_nodes(self) -> IntArray:
        """All other nodes: those that voltages are judged at."""
        return _read_only(np.flatnonzero(self.node_bus != 0), np.intp)

    @cached_property
    def load_slice(self) -> slice:
        """``load_nodes`` as a slice of an axis over nodes, which takes them without a copy: the source's come first."""
        return slice(len(self.source_nodes), None)

    def index(self, bus: BusId) -> int:
        """Position of a bus, given as text or a whole number, in ``bus_ids``; FeederError where there is none."""
        try:
            return self._index[bus_text(bus)]
        except KeyError:
            raise FeederError(f"feeder {self.name!r} has no bus {bus!r}; its buses are {list(self.bus_ids)}") from None

    def nodes_of(self, bus: BusId) -> tuple[int, ...]:
        """The nodes of a bus in the order of their phases; FeederError for a bus that there is not."""
        i = self.index(bus)
        return tuple(range(self.first_node[i], self.first_node[i + 1]))

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
        return _read_only([of_bus[bus] for bus in self.bus_ids])

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

    @cached_property
    def branches(self) -> Branches:
        """The generalised matrices of the branches, per unit."""
        return _frozen(branches_of(self.network, self._tree, self.base_kv_ln))

    @cached_property
    def load_legs(self) -> Legs:
        """The legs of the loads, which come first among the legs."""
        return _frozen(load_legs(self.network, self._nodes_by_phase, self._bases))

    @cached_property
    def capacitor_legs(self) -> Legs:
        """The legs of the capacitors, each of a row of their table."""
        return _frozen(capacitor_legs(self.network, self._nodes_by_phase, self._bases))

    @property
    def first_device_leg(self) -> int:
        """Number of legs of loads; leg ``first_device_leg + node`` is where a device at that node draws and injects."""
        return len(self.load_legs.bus)

    @property
    def n_leg(self) -> int:
        """Number of legs: those of the loads, then one for each node."""
        return self.first_device_leg + self.n_node

    @cached_property
    def leg_bus(self) -> IntArray:
        """Position in ``bus_ids`` of the bus of each leg, shape (n_leg,)."""
        return _read_only(np.concatenate((self.load_legs.bus, self.node_bus)), np.intp)

    @cached_property
    def p_load_kw(self) -> FloatArray:
        """Active power of each leg at its rated voltage in the base case, kW, shape (n_leg,); devices draw nothing."""
        return _read_only(np.concatenate((self.load_legs.p_kw, np.zeros(self.n_node))))

    @cached_property
    def q_load_kvar(self) -> FloatArray:
        """Reactive power of each leg at its rated voltage in the base case, kvar, shape (n_leg,)."""
        return _read_only(np.concatenate((self.load_legs.q_kvar, np.zeros(self.n_node))))

    @property
    def n_regulator(self) -> int:
        """Number of taps: one for each row of the regulators' table."""
        return len(self.network.regulator)

    @cached_property
    def base_tap(self) -> FloatArray:
        """Tap of each regulator in the base case, shape (n_regulator,)."""
        return _read_only(self.network.regulator.tap)

    def tap_ratio(self, tap: Any) -> Any:
        """Voltage ratio of each regulator at the given taps, shape (..., n_regulator), an array of the given kind."""
        step: Any = np.array(self.network.regulator.tap_step)
        if not isinstance(tap, np.ndarray | Sequence) and hasattr(tap, "new_tensor"):
            step = tap.new_tensor(step)
        return 1.0 + step * tap

    @property
    def n_capacitor(self) -> int:
        """Number of capacitor banks, each switched as one: the rows of the capacitors' table."""
        return len(self.network.capacitor)

    @cached_property
    def base_capacitor_on(self) -> FloatArray:
        """1 for a capacitor bank that is on in the base case, 0 for one that is off, shape (n_capacitor,)."""
        return _read_only([state == "on" for state in self.network.capacitor.state])


def _frozen(arrays: Any) -> Any:
    for array in arrays:
        array.flags.writeable = False
    return arrays
