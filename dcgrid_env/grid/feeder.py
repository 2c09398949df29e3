"""A radial distribution feeder: buses, branches, base load. Frozen and checked once, on the way in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.cache import fields_alone
from dcgrid_env.core.units import S_BASE_KVA, impedance_base_ohm
from dcgrid_env.grid.formats.csv_folder import check_lengths, check_numbers, read_feeder_tables
from dcgrid_env.grid.topology import FeederError, orient

BusId = int | str
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

__all__ = ["BusId", "Feeder", "FeederError"]


def _read_only(array: Any) -> Any:
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class Feeder:
    """A radial feeder. Every array over buses follows ``bus_ids``; branch ``k`` feeds bus ``k + 1``.

    Make one with :meth:`from_tables`, :meth:`from_csv` or :func:`dcgrid_env.load_feeder`: they check it and turn
    every branch away from the substation.

    Attributes
    ----------
    bus_ids
        The feeder's own bus names, in file order but for the substation, which is ``bus_ids[0]``.
    base_kv, v0_pu
        Line-to-line base voltage, kV; substation voltage of the published base case, per unit.
    p_load_kw, q_load_kvar, capacitor_kvar
        Base load (consumption positive) and shunt capacitors (injection positive), shape (n_bus,).
    parent
        Index of the bus at the sending end of branch k, shape (n_bus - 1,).
    r_ohm, x_ohm
        Series impedance per phase of the balanced equivalent, shape (n_bus - 1,). Zero is a closed switch.
    x, y
        Coordinates of the one-line diagram, shape (n_bus,), NaN where none are published.
    """

    name: str
    base_kv: float
    v0_pu: float
    bus_ids: tuple[BusId, ...]
    p_load_kw: FloatArray
    q_load_kvar: FloatArray
    capacitor_kvar: FloatArray
    parent: IntArray
    r_ohm: FloatArray
    x_ohm: FloatArray
    x: FloatArray
    y: FloatArray

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
    ) -> Feeder:
        """Check bus and branch tables and build the feeder. Branches may be given in either direction.

        Raises
        ------
        FeederError
            Naming the buses and branches: not radial, an island, an isolated bus, a duplicate or unknown bus, a
            negative or NaN figure.
        """
        n = len(bus_ids)
        check_lengths(name, "bus", n, {"x": x, "y": y})
        check_lengths(name, "branch", len(from_bus), {"to_bus": to_bus})
        buses = {
            "p_kw": p_load_kw,
            "q_kvar": q_load_kvar,
            "capacitor_kvar": [0.0] * n if capacitor_kvar is None else capacitor_kvar,
        }
        branch_names = [f"{i}-{j}" for i, j in zip(from_bus, to_bus, strict=True)]
        check_numbers(name, "feeder", ["base_kv", "v0_pu"], {"value": [base_kv, v0_pu]}, positive=True)
        check_numbers(name, "bus", bus_ids, buses)
        check_numbers(name, "branch", branch_names, {"r_ohm": r_ohm, "x_ohm": x_ohm}, non_negative=True)
        drawn = {field: values for field, values in (("x", x), ("y", y)) if values is not None}
        check_numbers(name, "bus", bus_ids, drawn, may_be_nan=True)
        order, parent, branch = orient(name, substation, bus_ids, from_bus, to_bus)
        nan = [np.nan] * n

        def frozen(values: Any, index: IntArray, dtype: Any = np.float64) -> Any:
            return _read_only(np.asarray(values, dtype=dtype)[index])

        return cls(
            name=name,
            base_kv=float(base_kv),
            v0_pu=float(v0_pu),
            bus_ids=tuple(bus_ids[i] for i in order),
            p_load_kw=frozen(buses["p_kw"], order),
            q_load_kvar=frozen(buses["q_kvar"], order),
            capacitor_kvar=frozen(buses["capacitor_kvar"], order),
            parent=frozen(parent, np.arange(n - 1), np.intp),
            r_ohm=frozen(r_ohm, branch),
            x_ohm=frozen(x_ohm, branch),
            x=frozen(nan if x is None else x, order),
            y=frozen(nan if y is None else y, order),
        )

    @classmethod
    def from_csv(cls, folder: str | Path) -> Feeder:
        """Read a feeder of your own from a folder with three files.

        ``feeder.toml``: name, base_kv (line to line), substation (bus), v0_pu.
        ``buses.csv``: bus, p_kw, q_kvar and, if known, capacitor_kvar, x, y.
        ``branches.csv``: from_bus, to_bus, r_ohm, x_ohm.

        Raises
        ------
        FeederError
            Naming the file, the row and the field, or the buses and branches.
        """
        return cls.from_tables(**read_feeder_tables(Path(folder)))

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

    def index(self, bus: BusId) -> int:
        """Position of a bus in ``bus_ids``; FeederError for one that the feeder does not have."""
        try:
            return self._index[bus]
        except KeyError:
            raise FeederError(f"feeder {self.name!r} has no bus {bus!r}; its buses are {list(self.bus_ids)}") from None

    @cached_property
    def _index(self) -> dict[BusId, int]:
        return {bus: i for i, bus in enumerate(self.bus_ids)}

    @cached_property
    def r_pu(self) -> FloatArray:
        """Series resistance of each branch, per unit, shape (n_bus - 1,)."""
        return _read_only(self.r_ohm / impedance_base_ohm(self.base_kv))

    @cached_property
    def x_pu(self) -> FloatArray:
        """Series reactance of each branch, per unit, shape (n_bus - 1,)."""
        return _read_only(self.x_ohm / impedance_base_ohm(self.base_kv))

    @cached_property
    def depth_first(self) -> IntArray:
        """Bus indices in depth-first order from the substation, shape (n_bus,): each subtree is one slice of it."""
        children: list[list[int]] = [[] for _ in range(self.n_bus)]
        for k, i in enumerate(self.parent):
            children[i].append(k + 1)
        order, stack = [], [0]
        while stack:
            i = stack.pop()
            order.append(i)
            stack.extend(reversed(children[i]))
        return _read_only(np.array(order, dtype=np.intp))

    @cached_property
    def path(self) -> FloatArray:
        """0/1 matrix, shape (n_bus, n_bus - 1): 1 where branch k lies between bus i and the substation."""
        path = np.zeros((self.n_bus, self.n_bus - 1))
        for j in self.depth_first[1:]:
            path[j] = path[self.parent[j - 1]]
            path[j, j - 1] = 1.0
        return _read_only(path)

    @cached_property
    def own_sensitivity(self) -> FloatArray:
        """Diagonals of ``sensitivity()``, shape (n_bus, 2): p.u. per MW, then p.u. per Mvar. No matrix is made."""
        own = np.zeros((self.n_bus, 2))
        for j in self.depth_first[1:]:
            own[j] = own[self.parent[j - 1]] + (self.r_pu[j - 1], self.x_pu[j - 1])
        return _read_only(own * (1000.0 / S_BASE_KVA))

    def sensitivity(self) -> tuple[FloatArray, FloatArray]:
        """LinDistFlow's R and X: drop of the voltage at i in p.u. for a load of 1 MW or 1 Mvar at j, around 1 p.u.

        Shape (n_bus, n_bus) each; the sums of r and x over the shared path to the substation (Baran and Wu 1989).
        """
        mega = 1000.0 / S_BASE_KVA
        return (self.path * self.r_pu) @ self.path.T * mega, (self.path * self.x_pu) @ self.path.T * mega
