"""An unbalanced three-phase radial feeder: buses of one to three phases, branches, legs. Frozen and checked once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import fields_alone
from dcgrid_env.grid.formats.three_phase_folder import read_folder, write_folder
from dcgrid_env.grid.network import Network
from dcgrid_env.grid.three_phase_checks import check_three_phase
from dcgrid_env.grid.three_phase_legs import Legs, capacitor_legs, core_legs, load_legs
from dcgrid_env.grid.three_phase_matrices import Branches, branches_of
from dcgrid_env.grid.three_phase_nodes import FloatArray, IntArray, PhaseNodes, read_only
from dcgrid_env.grid.three_phase_ratings import ratings_a
from dcgrid_env.grid.topology import FeederError

__all__ = ["ThreePhaseFeeder"]


@dataclass(frozen=True, eq=False)
class ThreePhaseFeeder(PhaseNodes):
    """A radial feeder of one, two and three phases. A *node* is a phase of a bus, the phases of a bus adjacent.

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
            Naming the component, the field and the value: an invalid cell, a loop, an island, a transformer
            that is fed from its secondary.
        """
        check_three_phase(network)
        feeder = cls(network)
        _ = feeder.branches
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
        """The generalised matrices of the branches, per unit."""
        return _frozen(branches_of(self.network, self._tree, self.base_kv_ln))

    @cached_property
    def rating_a(self) -> FloatArray | None:
        """Rated current of what feeds each node, A, shape (n_node,), NaN where unknown; None if none is known.

        Of a transformer it is that of its to-side, at the rated voltage of which it carries its kVA; see
        ``three_phase_ratings``.
        """
        ratings = ratings_a(self.network, self._tree)
        return None if np.isnan(ratings).all() else read_only(ratings)

    @cached_property
    def regulated(self) -> IntArray:
        """Nodes that a regulator feeds."""
        fed = np.array([False, *(branch.kind == "regulator" for branch in self._tree.branches)])
        return read_only(np.flatnonzero(fed[self.node_bus]), np.intp)

    @cached_property
    def branch_names(self) -> tuple[str, ...]:
        """Names of the branches by kind and name, as in ``"transformer xfm1"``."""
        return tuple(f"{b.kind.removeprefix('phase_')} {b.name}" for b in self._tree.branches)

    @cached_property
    def load_legs(self) -> Legs:
        """The legs of the loads, which come first among the legs."""
        return _frozen(load_legs(self.network, self._nodes_by_phase, self._bases))

    @cached_property
    def capacitor_legs(self) -> Legs:
        """The legs of the capacitors, each of a row of their table."""
        return _frozen(capacitor_legs(self.network, self._nodes_by_phase, self._bases))

    @cached_property
    def core_legs(self) -> Legs:
        """The legs of the transformers' cores, which draw their no-load losses."""
        return _frozen(core_legs(self.network, self._nodes_by_phase, self._bases))

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
