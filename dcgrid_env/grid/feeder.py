"""A balanced distribution feeder: buses, branches, base load. Frozen and checked once, on the way in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.cache import fields_alone
from dcgrid_env.grid.balanced_nodes import OneNodeABus
from dcgrid_env.grid.formats.csv_folder import read_csv, write_csv
from dcgrid_env.grid.formats.feeder_folder import is_three_phase
from dcgrid_env.grid.formats.import_stamp import warn_about_stamp
from dcgrid_env.grid.network import (
    BusId,
    LineTable,
    Network,
    NodeTable,
    RatingTable,
    balanced_network,
    bus_text,
    summed_at_nodes,
)
from dcgrid_env.grid.network_checks import check_balanced, check_lengths, check_loop_impedance
from dcgrid_env.grid.optional_fields import as_column, check_optional_fields, optional_fields
from dcgrid_env.grid.per_unit import PerUnit
from dcgrid_env.grid.topology import FeederError, listed, orient

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

__all__ = ["Feeder", "FeederError"]


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class Feeder(PerUnit, OneNodeABus):
    """A radial or weakly meshed feeder. Every array over buses follows ``bus_ids``; branch ``k`` feeds bus ``k + 1``.

    The first n_bus - 1 branches are the breadth-first tree from the substation, which visits neighbours in the order of
    the buses. Each further branch closes a loop, where the two sides of the loop meet.

    Make one with :meth:`from_tables`, :meth:`from_csv` or :func:`dcgrid_env.load_feeder`: they check it and turn
    every branch away from the substation.

    Attributes
    ----------
    bus_ids
        The feeder's own bus names, as text, in file order except the substation, which is ``bus_ids[0]``.
    base_kv, v0_pu
        Line-to-line base voltage, kV; substation voltage of the published base case, per unit.
    p_load_kw, q_load_kvar, capacitor_kvar
        Base load (consumption positive) and shunt capacitors (injection positive), shape (n_bus,).
    parent
        Index of the bus that feeds bus k + 1 through branch k, shape (n_bus - 1,).
    r_ohm, x_ohm
        Series impedance per phase of the balanced equivalent, shape (n_branch,). Zero is a closed switch.
    x, y
        Coordinates of the one-line diagram, shape (n_bus,), NaN where none are published.
    shunt_kw, shunt_kvar
        Constant admittance at each bus, shape (n_bus,): draws ``shunt_kw`` v^2 and injects ``shunt_kvar`` v^2 at a
        referred voltage of v p.u. None where there is none.
    voltage_ratio
        Voltage of each bus, per unit of the bus's base, over its voltage referred to the substation, shape (n_bus,).
        It differs from 1 behind transformers with an off-nominal ratio. None if all are 1.
    bus_base_kv
        Line-to-line base voltage of each bus, kV, shape (n_bus,), for information; None where all are ``base_kv``.
    rating_a
        Ampacity of each branch, A, shape (n_branch,), NaN where it is not known; None where none is.
    loop_ends
        Indices of the sending and the receiving bus of each branch that closes a loop, shape (n_loop, 2). None for a
        radial feeder.
    seasonal_ratings
        Ratings by season and for emergencies, A, which ``with_ratings`` chooses from; None where none are known.

    The power flow runs in quantities referred to the substation's base voltage by the actual ratios of the transformers
    between: so are ``r_ohm``, ``x_ohm`` and ``rating_a``, which makes an ideal transformer exact.
    """

    name: str
    base_kv: float
    v0_pu: float
    bus_ids: tuple[str, ...]
    p_load_kw: FloatArray
    q_load_kvar: FloatArray
    capacitor_kvar: FloatArray
    parent: IntArray
    r_ohm: FloatArray
    x_ohm: FloatArray
    x: FloatArray
    y: FloatArray
    shunt_kw: FloatArray | None = None
    shunt_kvar: FloatArray | None = None
    voltage_ratio: FloatArray | None = None
    bus_base_kv: FloatArray | None = None
    rating_a: FloatArray | None = None
    loop_ends: IntArray | None = None
    seasonal_ratings: RatingTable | None = None

    def __post_init__(self) -> None:
        check_optional_fields(self)

    @classmethod
    def from_tables(
        cls,
        *,
        name: str,
        base_kv: float,
        substation: BusId,
        v0_pu: float,
        bus_ids: Sequence[BusId],
        p_load_kw: Sequence[float],
        q_load_kvar: Sequence[float],
        from_bus: Sequence[BusId],
        to_bus: Sequence[BusId],
        r_ohm: Sequence[float],
        x_ohm: Sequence[float],
        capacitor_kvar: Sequence[float] | None = None,
        x: Sequence[float] | None = None,
        y: Sequence[float] | None = None,
        shunt_kw: Sequence[float] | None = None,
        shunt_kvar: Sequence[float] | None = None,
        voltage_ratio: Sequence[float] | None = None,
        bus_base_kv: Sequence[float] | None = None,
        rating_a: Sequence[float] | None = None,
    ) -> Feeder:
        """Check bus and branch tables and build the feeder. Branches may be given in either direction.

        Raises
        ------
        FeederError
            Naming the buses and branches: too many loops, a loop without impedance, an island, an isolated bus, a
            duplicate or unknown bus, a negative or NaN figure.
        """
        n, nan = len(bus_ids), [math.nan] * len(bus_ids)
        capacitors = [0.0] * n if capacitor_kvar is None else capacitor_kvar
        columns = {"p_kw": p_load_kw, "q_kvar": q_load_kvar, "capacitor_kvar": capacitors}
        columns |= {"shunt_kw": shunt_kw, "shunt_kvar": shunt_kvar}
        node_columns = {"voltage_ratio": voltage_ratio, "bus_base_kv": bus_base_kv}
        check_lengths(name, "bus", n, columns | node_columns | {"x": x, "y": y})
        line_columns = {"to_bus": to_bus, "r_ohm": r_ohm, "x_ohm": x_ohm, "rating_a": rating_a}
        check_lengths(name, "branch", len(from_bus), line_columns)
        nodes = NodeTable(
            bus_ids,  # pyright: ignore[reportArgumentType]
            [0] * n,
            nan if x is None else x,
            nan if y is None else y,
            base_kv=() if bus_base_kv is None else bus_base_kv,
            voltage_ratio=() if voltage_ratio is None else voltage_ratio,
        )
        lines = LineTable(from_bus, to_bus, r_ohm, x_ohm, () if rating_a is None else rating_a)  # pyright: ignore
        network = balanced_network(
            name, base_kv=base_kv, substation=substation, v0_pu=v0_pu, nodes=nodes, lines=lines, **columns
        )
        return cls.from_network(network)

    @classmethod
    def from_network(cls, network: Network) -> Feeder:
        """Compile component tables: order buses and branches from the substation, and add up loads at each bus.

        Raises
        ------
        FeederError
            For tables that are not those of a balanced feeder, naming the component, the field and the value.
        """
        check_balanced(network)
        node, line, load, shunt, source = network.node, network.line, network.load, network.shunt, network.source
        order, parent, branch, loop_ends = orient(network.name, source.bus[0], node.bus, line.from_bus, line.to_bus)
        if loop_ends:
            check_loop_impedance(network.name, line)

        def frozen(values: object, rows: IntArray) -> FloatArray:
            return _read_only(np.asarray(values, dtype=np.float64)[rows])

        return cls(
            name=network.name,
            base_kv=float(source.base_kv[0]),
            v0_pu=float(source.v_pu[0]),
            bus_ids=tuple(str(node.bus[i]) for i in order.tolist()),
            p_load_kw=frozen(summed_at_nodes(node, load.bus, load.p_kw), order),
            q_load_kvar=frozen(summed_at_nodes(node, load.bus, load.q_kvar), order),
            capacitor_kvar=frozen(summed_at_nodes(node, shunt.bus, shunt.capacitor_kvar), order),
            parent=_read_only(np.array(parent, dtype=np.intp)),
            r_ohm=frozen(line.r_ohm, branch),
            x_ohm=frozen(line.x_ohm, branch),
            x=frozen(node.x, order),
            y=frozen(node.y, order),
            loop_ends=_read_only(np.array(loop_ends, dtype=np.intp)) if loop_ends else None,
            seasonal_ratings=network.rating if len(network.rating) else None,
            **optional_fields(network, order, branch),
        )

    @cached_property
    def branch_names(self) -> tuple[str, ...]:
        """Names of the branches by the buses that they join, as in ``"branch 5-6"``."""
        ids = self.bus_ids
        return tuple(f"branch {ids[i]}-{ids[j]}" for i, j in zip(self.from_bus, self.to_bus, strict=True))

    @cached_property
    def opened(self) -> Feeder:
        """This feeder with each loop opened at the receiving end of the branch that closes it; itself if radial.

        The branch then feeds a further bus, without load and behind all others, in the place of its receiving bus. The
        opened feeder is radial, and its branches are those of this one.
        """
        if self.loop_ends is None:
            return self
        sending, receiving = self.loop_ends.T
        ends = tuple(f"end of {name}" for name in self.branch_names[self.n_bus - 1 :])

        def extended(values: FloatArray | None, further: float | None = 0.0) -> FloatArray | None:
            if values is None:
                return None
            added = values[receiving] if further is None else np.full(len(ends), further)
            return _read_only(np.concatenate((values, added)))

        changed: dict[str, Any] = {
            field: extended(getattr(self, field))
            for field in ("p_load_kw", "q_load_kvar", "capacitor_kvar", "shunt_kw", "shunt_kvar")
        }
        changed |= {field: extended(getattr(self, field), None) for field in ("x", "y", "voltage_ratio", "bus_base_kv")}
        parent = _read_only(np.concatenate((self.parent, sending)))
        return replace(
            self, bus_ids=self.bus_ids + ends, parent=parent, loop_ends=None, seasonal_ratings=None, **changed
        )

    def to_network(self) -> Network:
        """Return the component tables of this feeder, from which :meth:`from_network` makes an equal feeder."""
        from_bus, to_bus = ([self.bus_ids[i] for i in ends] for ends in (self.from_bus, self.to_bus))
        base_kv, ratio, rating_a = map(as_column, (self.bus_base_kv, self.voltage_ratio, self.rating_a))
        network = balanced_network(
            self.name,
            base_kv=self.base_kv,
            substation=self.bus_ids[0],
            v0_pu=self.v0_pu,
            nodes=NodeTable(
                self.bus_ids,
                self.node_phase.tolist(),
                self.x.tolist(),
                self.y.tolist(),
                base_kv=base_kv,
                voltage_ratio=ratio,
            ),
            p_kw=self.p_load_kw.tolist(),
            q_kvar=self.q_load_kvar.tolist(),
            capacitor_kvar=self.capacitor_kvar.tolist(),
            lines=LineTable(from_bus, to_bus, self.r_ohm.tolist(), self.x_ohm.tolist(), rating_a),
            shunt_kw=as_column(self.shunt_kw) or None,
            shunt_kvar=as_column(self.shunt_kvar) or None,
        )
        return network if self.seasonal_ratings is None else replace(network, rating=self.seasonal_ratings)

    @classmethod
    def from_csv(cls, folder: str | Path) -> Feeder:
        """Read a custom feeder from a folder.

        ``feeder.toml``: name, base_kv (line to line), substation (bus), v0_pu.
        ``buses.csv``: bus, p_kw, q_kvar and, if known, capacitor_kvar, x, y, shunt_kw, shunt_kvar, voltage_ratio,
        base_kv.
        ``branches.csv``: from_bus, to_bus, r_ohm, x_ohm and, if known, rating_a.
        ``ratings.csv``, optional: element, season, normal, emergency.

        Raises
        ------
        FeederError
            Naming the file, the row and the field, or the buses and branches; for the folder of a three-phase feeder.
        """
        if is_three_phase(Path(folder)):
            raise FeederError(f"{folder} holds a three-phase feeder; read it by ThreePhaseFeeder.from_csv")
        try:
            feeder = cls.from_network(read_csv(Path(folder)))
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
        write_csv(self.to_network(), Path(folder))

    def __deepcopy__(self, memo: dict[int, Any]) -> Feeder:
        return self  # frozen: a copy shares it

    def __getstate__(self) -> dict[str, Any]:
        return fields_alone(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():  # arrays come out of a pickle writable
            object.__setattr__(self, name, _read_only(value) if isinstance(value, np.ndarray) else value)

    @property
    def n_bus(self) -> int:
        """Number of buses, the substation among them."""
        return len(self.bus_ids)

    @property
    def n_branch(self) -> int:
        """Number of branches: one for each bus but the substation, and one for each loop."""
        return len(self.r_ohm)

    @property
    def n_loop(self) -> int:
        """Number of loops, 0 for a radial feeder."""
        return 0 if self.loop_ends is None else len(self.loop_ends)

    def scaled(self, r_share: float, x_share: float) -> Feeder:
        """Return this feeder with every line's resistance and reactance multiplied by a share."""
        return replace(self, r_ohm=r_share * self.r_ohm, x_ohm=x_share * self.x_ohm)

    def index(self, bus: BusId) -> int:
        """Return the position of a bus, text or a whole number, in ``bus_ids``; FeederError for an unknown bus."""
        try:
            return self._index[bus_text(bus)]
        except KeyError:
            raise FeederError(
                f"feeder {self.name!r} has no bus {bus!r}; its buses are {listed(self.bus_ids)}"
            ) from None

    @cached_property
    def _index(self) -> dict[str, int]:
        return {bus: i for i, bus in enumerate(self.bus_ids)}
