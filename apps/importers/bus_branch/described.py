"""A feeder as buses and branches at each bus's base voltage, from which the formats write it."""
# ruff: noqa: D102  (the protocol's members are ``Feeder``'s, and described there)

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.apps.importers.bus_branch.description import (
    Branch,
    BusBranchGrid,
    FloatArray,
    Source,
    empty_grid,
)


class BalancedFeeder(Protocol):
    """Attributes of ``Feeder`` that a format needs; ``Feeder`` itself imports the formats, so it is not imported."""

    @property
    def name(self) -> str: ...
    @property
    def base_kv(self) -> float: ...
    @property
    def v0_pu(self) -> float: ...
    @property
    def bus_ids(self) -> tuple[str, ...]: ...
    @property
    def p_load_kw(self) -> FloatArray: ...
    @property
    def q_load_kvar(self) -> FloatArray: ...
    @property
    def capacitor_kvar(self) -> FloatArray: ...
    @property
    def from_bus(self) -> NDArray[np.intp]: ...
    @property
    def to_bus(self) -> NDArray[np.intp]: ...
    @property
    def r_ohm(self) -> FloatArray: ...
    @property
    def x_ohm(self) -> FloatArray: ...
    @property
    def x(self) -> FloatArray: ...
    @property
    def y(self) -> FloatArray: ...
    @property
    def shunt_kw(self) -> FloatArray | None: ...
    @property
    def shunt_kvar(self) -> FloatArray | None: ...
    @property
    def voltage_ratio(self) -> FloatArray | None: ...
    @property
    def bus_base_kv(self) -> FloatArray | None: ...
    @property
    def rating_a(self) -> FloatArray | None: ...


def described(feeder: BalancedFeeder, base_mva: float = 1.0) -> BusBranchGrid:
    """Return buses and branches of a feeder; a branch between buses of one ratio is a line, another a transformer.

    Capacitors of constant kvar are part of the loads, because no other format separates the two.
    """
    n = len(feeder.bus_ids)
    base_kv = np.full(n, feeder.base_kv) if feeder.bus_base_kv is None else feeder.bus_base_kv
    ratio = np.ones(n) if feeder.voltage_ratio is None else feeder.voltage_ratio
    grid = empty_grid(feeder.name, base_mva, feeder.bus_ids, base_kv)
    grid.p_kw = feeder.p_load_kw.copy()
    grid.q_kvar = feeder.q_load_kvar - feeder.capacitor_kvar
    if feeder.shunt_kw is not None:
        grid.shunt_kw = feeder.shunt_kw / ratio**2
    if feeder.shunt_kvar is not None:
        grid.shunt_kvar = feeder.shunt_kvar / ratio**2
    grid.x, grid.y = feeder.x, feeder.y
    grid.sources = [Source("source", feeder.bus_ids[0], 0, feeder.v0_pu)]
    z_base_ohm = feeder.base_kv**2 / base_mva
    i_base_a = 1000.0 * base_mva / (math.sqrt(3.0) * feeder.base_kv)
    z_pu = (feeder.r_ohm + 1j * feeder.x_ohm) / z_base_ohm
    rating_pu = np.full(len(z_pu), math.nan) if feeder.rating_a is None else feeder.rating_a / i_base_a
    for k, (i, j) in enumerate(zip(feeder.from_bus.tolist(), feeder.to_bus.tolist(), strict=True)):
        kind = "line" if ratio[i] == ratio[j] and base_kv[i] == base_kv[j] else "transformer"
        grid.branches.append(
            Branch(
                kind,
                f"{feeder.bus_ids[i]}-{feeder.bus_ids[j]}",
                i,
                j,
                complex(z_pu[k]) * float(ratio[j]) ** 2,
                tap=float(ratio[i] / ratio[j]),
                rating_pu=float(rating_pu[k] / ratio[j]),
            )
        )
    return grid
