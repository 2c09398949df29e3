"""An unbalanced three-phase feeder: buses of one to three phases, branches, legs. Frozen and checked once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import fields_alone
from dcgrid_env.grid.capacitor_meters import Meter, meter_of
from dcgrid_env.grid.formats.import_stamp import warn_about_stamp
from dcgrid_env.grid.formats.three_phase_folder import read_folder, write_folder
from dcgrid_env.grid.network import Network
from dcgrid_env.grid.nodal_matrices import NodalMatrices, nodal_matrices
from dcgrid_env.grid.three_phase_checks import check_three_phase
from dcgrid_env.grid.three_phase_legs import Legs, capacitor_legs, core_legs, joined, load_legs
from dcgrid_env.grid.three_phase_matrices import Branches, branches_of
from dcgrid_env.grid.three_phase_nodes import FloatArray, IntArray, PhaseNodes, read_only
from dcgrid_env.grid.three_phase_ratings import ratings_a
from dcgrid_env.grid.topology import FeederError

__all__ = ["ThreePhaseFeeder"]


@dataclass(frozen=True, eq=False)
class ThreePhaseFeeder(PhaseNodes):
    """A feeder of one, two and three phases. A *node* is a phase, or another conductor, of a bus.

    On radial feeders one branch brings each bus all of its phases. Any other feeder, with loops, split-phase
    transformers or neutral conductors, is solved by nodal admittances (``nodal``).

    Make one with :meth:`from_network`, :meth:`from_csv` or :func:`dcgrid_env.load_feeder`: they check it. Every array
    over buses follows ``bus_ids``, which run depth first from the source bus; branch ``k`` feeds bus ``k + 1``.

    A *leg* draws power from a node to another or to ground. First come the legs of the loads, then one leg from
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
            Naming the component, the field and the value: an invalid cell, an island, a transformer of a radial
            feeder that is fed from its secondary, a node without any connection to ground.
        """
        check_three_phase(network)
        feeder = cls(network)
        _ = feeder.branches if feeder.is_radial else feeder.nodal, feeder.capacitor_meters
        return feeder

    def to_network(self) -> Network:
        """Return the component tables of this feeder, from which :meth:`from_network` makes an equal feeder."""
        return self.network

    @classmethod
    def from_csv(cls, folder: str | Path) -> ThreePhaseFeeder:
        """Read a custom feeder from a folder of tables: see ``dcgrid_env.grid.formats.three_phase_folder``.

        Raises
        ------
        FeederError
            Naming the file, the row and the field, or the component, the field and the value.
        """
        try:
            feeder = cls.from_network(read_folder(Path(folder)))
        except FeederError as error:
            raise error if str(folder) in str(error) else FeederError(f"{folder}: {error}") from None
        warn_about_stamp(Path(folder))
        feeder.__dict__["_folder"] = Path(folder).absolute()  # beside the fields, which are what the feeder is
        return feeder

    @property
    def folder(self) -> Path | None:
        """Folder that it was read from; None for a feeder made otherwise, or unpickled."""
        return self.__dict__.get("_folder")

    def to_csv(self, folder: str | Path) -> None:
        """Write the files that :meth:`from_csv` reads; reading returns exactly the same feeder."""
        write_folder(self.network, Path(folder))

    def __deepcopy__(self, memo: dict[int, Any]) -> ThreePhaseFeeder:
        return self  # frozen: a copy shares it

    def __getstate__(self) -> dict[str, Any]:
        return fields_alone(self)

    @property
    def v0_pu(self) -> float:
        """Voltage of the ideal source behind the source's impedance, p.u."""
        return float(self.network.source.v_pu[0])

    @cached_property
    def source_angle_deg(self) -> FloatArray:
        """Angles of the ideal source's phases a, b, c, shape (3,)."""
        return read_only(self.network.source.angle_deg[0] - np.array([0.0, 120.0, 240.0]))

    @cached_property
    def branches(self) -> Branches:
        """The generalised matrices of the branches of a radial feeder, per unit."""
        return _frozen(branches_of(self.network, self._tree, self.base_kv_ln))

    @cached_property
    def nodal(self) -> NodalMatrices:
        """The nodal admittances of a feeder that is not radial, per unit."""
        legs = joined((self.load_legs, self.capacitor_legs))
        return nodal_matrices(self.network, self._nodes_by_phase, self.base_kv_ln[self.node_bus], legs)

    @cached_property
    def n_unknown(self) -> int:
        """Number of complex figures that a power flow starts from: the nodes, and couplers of nodal equations."""
        return self.n_node if self.is_radial else self.n_node + len(self.nodal.coupler_z)

    @cached_property
    def node_parent(self) -> IntArray:
        """Node that feeds each node, -1 at the source bus, shape (n_node,). On radial feeders it has the same phase."""
        if not self.is_radial:
            return read_only(self.nodal.parent, np.intp)
        parents = [-1] * len(self.bus_phases[0])
        for i in range(1, self.n_bus):
            sender = self.parent[i - 1]
            parents += [self.first_node[sender] + self.bus_phases[sender].index(p) for p in self.bus_phases[i]]
        return read_only(parents, np.intp)

    @cached_property
    def node_regulator(self) -> IntArray:
        """Row of the regulator that feeds each node, shape (n_node,); -1 where none does."""
        if not self.is_radial:
            return read_only(self.nodal.regulator, np.intp)
        position = np.arange(self.n_node) - self.first_node[self.node_bus]
        return read_only(self.branches.regulator[self.node_bus, position], np.intp)

    @cached_property
    def branch_z_pu(self) -> FloatArray:
        """Magnitude of the series impedance of the branch to each bus but the first, p.u., shape (n_branch,).

        Of branches of several phases it is that of their positive sequence: the mean of the diagonal less that of the
        entries off it. On feeders that are not radial it is the mean of the phases.
        """
        if not self.is_radial:
            judged = self.node_phase <= 3
            sums = np.bincount(self.node_bus[judged], self.nodal.z_pu[judged], self.n_bus)
            return read_only((sums / np.maximum(np.bincount(self.node_bus[judged], minlength=self.n_bus), 1))[1:])
        n_phase, b = np.array([len(phases) for phases in self.bus_phases]), self.branches.b
        self_sum = np.trace(b, axis1=1, axis2=2)
        mutual = b.sum(axis=(1, 2)) - self_sum
        return read_only(np.abs(self_sum / n_phase - mutual / np.maximum(n_phase * (n_phase - 1), 1))[1:])

    @cached_property
    def rating_a(self) -> FloatArray | None:
        """Rated current of what feeds each node, A, shape (n_node,), NaN where unknown; None if none is known.

        Of a transformer it is that of its to-side, at the rated voltage of which it carries its kVA; see
        ``three_phase_ratings``.
        """
        ratings = ratings_a(self.network, self._tree) if self.is_radial else self.nodal.rating_a
        return None if np.isnan(ratings).all() else read_only(ratings)

    @cached_property
    def regulated(self) -> IntArray:
        """Nodes that a regulator feeds."""
        return read_only(np.flatnonzero(self.node_regulator >= 0), np.intp)

    @cached_property
    def branch_names(self) -> tuple[str, ...]:
        """Names of the branches by kind and name, as in ``"transformer xfm1"``."""
        table = self.network.admittance
        kinds = (table.kind[b.rows[0]] if b.kind == "admittance" else b.kind for b in self._tree.branches)
        names = (b.name for b in self._tree.branches)
        return tuple(f"{kind.removeprefix('phase_')} {name}" for kind, name in zip(kinds, names, strict=True))

    @cached_property
    def load_legs(self) -> Legs:
        """The legs of the loads, which come first among the legs."""
        return _frozen(load_legs(self.network, self._nodes_by_phase, self._bases))

    @cached_property
    def capacitor_legs(self) -> Legs:
        """The legs of the capacitors, each of a row of their table."""
        return _frozen(capacitor_legs(self.network, self._nodes_by_phase, self._bases))

    @cached_property
    def capacitor_meters(self) -> tuple[Meter | None, ...]:
        """Where each row of the capacitors' controls measures current; None for one that measures voltage alone."""
        return tuple(meter_of(self, self.node_parent, row) for row in range(len(self.network.capacitor_control)))

    @cached_property
    def core_legs(self) -> Legs:
        """The legs of the transformers' cores, which draw their no-load losses, and the negative ``nodal.carrying``."""
        cores = core_legs(self.network, self._nodes_by_phase, self._bases)
        if not self.is_radial:
            carrying = self.nodal.carrying
            cores = joined((cores, carrying._replace(p_kw=-carrying.p_kw, q_kvar=-carrying.q_kvar)))
        return _frozen(cores)

    @cached_property
    def first_device_leg(self) -> int:
        """Number of legs of loads; leg ``first_device_leg + node`` is where a device at that node draws and injects."""
        return len(self.load_legs.bus)

    @cached_property
    def n_leg(self) -> int:
        """Number of legs: those of the loads, then one for each node."""
        return self.first_device_leg + self.n_node

    @cached_property
    def leg_bus(self) -> IntArray:
        """Position in ``bus_ids`` of the bus of each leg, shape (n_leg,)."""
        return read_only(np.concatenate((self.load_legs.bus, self.node_bus)), np.intp)

    @cached_property
    def leg_node(self) -> IntArray:
        """Node of each leg, the first of its two where it joins two, shape (n_leg,)."""
        return read_only(np.concatenate((self.load_legs.node, np.arange(self.n_node))), np.intp)

    @cached_property
    def p_load_kw(self) -> FloatArray:
        """Active power of each leg at its rated voltage in the base case, kW, shape (n_leg,); devices draw nothing."""
        return read_only(np.concatenate((self.load_legs.p_kw, np.zeros(self.n_node))))

    @cached_property
    def q_load_kvar(self) -> FloatArray:
        """Reactive power of each leg at its rated voltage in the base case, kvar, shape (n_leg,)."""
        return read_only(np.concatenate((self.load_legs.q_kvar, np.zeros(self.n_node))))

    @cached_property
    def n_regulator(self) -> int:
        """Number of taps: one for each row of the regulators' table."""
        return len(self.network.regulator)

    @cached_property
    def base_tap(self) -> FloatArray:
        """Tap of each regulator in the base case, shape (n_regulator,)."""
        return read_only(self.network.regulator.tap)

    @cached_property
    def _tap_step(self) -> FloatArray:
        return read_only(self.network.regulator.tap_step)

    def tap_ratio(self, tap: Array) -> Array:
        """Voltage ratio of each regulator at the given taps, shape (..., n_regulator), an array of the given kind."""
        step: Any = self._tap_step
        if not isinstance(tap, np.ndarray | Sequence) and hasattr(tap, "new_tensor"):
            step = tap.new_tensor(np.array(step))  # a copy: tensors cannot share read-only memory
        return 1.0 + step * tap

    @cached_property
    def n_capacitor(self) -> int:
        """Number of capacitor banks, each switched as one: the rows of the capacitors' table."""
        return len(self.network.capacitor)

    @cached_property
    def base_capacitor_on(self) -> FloatArray:
        """1 for a capacitor bank that is on in the base case, 0 for one that is off, shape (n_capacitor,)."""
        return read_only([state == "on" for state in self.network.capacitor.state])


def _frozen(arrays: Any) -> Any:
    for array in arrays:
        array.flags.writeable = False
    return arrays
