"""The legs of a three-phase feeder: elements that draw between two nodes, or between a node and ground.

With u the voltage across a leg over its rated voltage, a leg draws I = (p h_p - j q h_q) V / V_rated^2, and

    h = z + i / u + c / u^2               by its model's shares z, i, c, for vmin <= u <= vmax
    h = h(vmax)                           above: the impedance that meets the law at vmax
    h = s + (1 - s) vlow / u              for vlow <= u < vmin: the current h u falls linearly to that of the rated
                                          impedance, s = (h(vmin) vmin - vlow) / (vmin - vlow)
    h = 1                                 below vlow: the rated impedance

for p and q each. These are OpenDSS's limits. A leg of constant impedance has h = 1 everywhere. One with exponents e has

    h = u^(e - 2)                         for vmin <= u <= vmax

and beyond that the h of constant power (c = 1), as in OpenDSS.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.network import Network
from dcgrid_env.grid.three_phase_checks import legs_of

SHARES = {
    "PQ": (0.0, 0.0, 1.0, 0.0, 0.0, 1.0),
    "I": (0.0, 1.0, 0.0, 0.0, 1.0, 0.0),
    "Z": (1.0, 0.0, 0.0, 1.0, 0.0, 0.0),
    "CVR": (0.0, 1.0, 0.0, 1.0, 0.0, 0.0),
    "EXP": (0.0, 0.0, 1.0, 0.0, 0.0, 1.0),
}
"""Shares of constant impedance, current and power in p, then in q; of EXP beyond its limits."""


class Legs(NamedTuple):
    """Legs of the loads and the capacitors; all fields except names are arrays over legs."""

    row: NDArray[np.intp]
    """Row of the table that the leg is of."""
    bus: NDArray[np.intp]
    node: NDArray[np.intp]
    other: NDArray[np.intp]
    """The node at the other end, -1 for ground."""
    p_kw: NDArray[np.float64]
    q_kvar: NDArray[np.float64]
    rated_pu: NDArray[np.float64]
    """Rated voltage over the line-to-neutral base voltage of the bus."""
    share: NDArray[np.float64]
    """Shares of constant impedance, current and power in p, then in q, shape (6, leg)."""
    limit_pu: NDArray[np.float64]
    """vlow, vmin and vmax over the rated voltage, shape (3, leg)."""
    exponent: NDArray[np.float64]
    """Exponents of p and q, NaN for legs without, shape (2, leg)."""


def load_legs(network: Network, first_node: dict[str, dict[str, int]], bases: dict[str, float]) -> Legs:
    """Legs of the loads' table, in its order; a leg with neither active nor reactive power is none.

    ``first_node`` maps a bus and a phase to the node, ``bases`` a bus to its base voltage, line to neutral, kV.
    """
    table = network.phase_load
    rows = [
        (row, leg, table.p_kw[row][i], table.q_kvar[row][i])
        for row in range(len(table))
        for i, leg in enumerate(legs_of(table.connection[row]))
        if table.p_kw[row][i] != 0 or table.q_kvar[row][i] != 0
    ]
    limits = [(table.vlow_pu[r], table.vmin_pu[r], table.vmax_pu[r]) for r, *_ in rows]
    shares = [table.zip[r] or SHARES[table.model[r]] for r, *_ in rows]
    exponents = [(table.exponents[r] if table.exponents else ()) or (np.nan, np.nan) for r, *_ in rows]
    return _legs(table, rows, shares, limits, first_node, bases, exponents)


def capacitor_legs(network: Network, first_node: dict[str, dict[str, int]], bases: dict[str, float]) -> Legs:
    """Legs of the capacitors' table, each with a negative reactive load and the law of an impedance."""
    table = network.capacitor
    rows = [
        (row, leg, 0.0, -table.kvar[row][i])
        for row in range(len(table))
        for i, leg in enumerate(legs_of(table.connection[row]))
        if table.kvar[row][i] != 0
    ]
    return _legs(table, rows, [SHARES["Z"]] * len(rows), [(0.5, 0.9, 1.1)] * len(rows), first_node, bases)


def core_legs(network: Network, first_node: dict[str, dict[str, int]], bases: dict[str, float]) -> Legs:
    """Legs of the transformers' cores, each with the law of an impedance."""
    table = network.core
    rows = [
        (row, leg, table.p_kw[row][i], table.q_kvar[row][i])
        for row in range(len(table))
        for i, leg in enumerate(legs_of(table.connection[row]))
        if table.p_kw[row][i] != 0 or table.q_kvar[row][i] != 0
    ]
    return _legs(table, rows, [SHARES["Z"]] * len(rows), [(0.5, 0.9, 1.1)] * len(rows), first_node, bases)


def chosen(legs: Legs, which: NDArray[np.bool_]) -> Legs:
    """Some of the legs."""
    columns: Any = (column[..., which] for column in legs)
    return Legs(*columns)


def joined(legs: Sequence[Legs]) -> Legs:
    """All legs of several, one after the other."""
    columns: Any = (np.concatenate(of_all, axis=-1) for of_all in zip(*legs, strict=True))
    return Legs(*columns)


def _legs(
    table: Any,
    rows: list,
    shares: list,
    limits: list,
    nodes: dict,
    bases: dict[str, float],
    exponents: list | None = None,
) -> Legs:
    position = {bus: i for i, bus in enumerate(nodes)}
    buses = [table.bus[row] for row, *_ in rows]
    ends = [[nodes[bus][phase] for phase in leg] for bus, (_, leg, *_) in zip(buses, rows, strict=True)]
    return Legs(
        row=np.array([row for row, *_ in rows], np.intp),
        bus=np.array([position[bus] for bus in buses], np.intp),
        node=np.array([end[0] for end in ends], np.intp),
        other=np.array([end[1] if len(end) > 1 else -1 for end in ends], np.intp),
        p_kw=np.array([p for *_, p, _ in rows], np.float64),
        q_kvar=np.array([q for *_, q in rows], np.float64),
        rated_pu=np.array([table.leg_kv[row] / bases[bus] for bus, (row, *_) in zip(buses, rows, strict=True)]),
        share=np.array(shares, np.float64).reshape(-1, 6).T.copy(),
        limit_pu=np.array(limits, np.float64).reshape(-1, 3).T.copy(),
        exponent=np.array(exponents or [(np.nan, np.nan)] * len(rows), np.float64).reshape(-1, 2).T.copy(),
    )
