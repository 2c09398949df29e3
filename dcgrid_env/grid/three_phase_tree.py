"""The branches of a three-phase grid as a tree from its source: which table's row feeds each bus, and from where.

A grid is *radial* if one branch brings each bus all of its phases and other elements connect no buses. On other grids
the tree spans the buses and leaves the other branches out; it serves maps and names, not the power flow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.grid.network import Network
from dcgrid_env.grid.three_phase_checks import node_names
from dcgrid_env.grid.three_phase_tables import LETTERS
from dcgrid_env.grid.topology import FeederError, depth_first, orient


class Branch(NamedTuple):
    """What joins two buses: one row of a table, or several regulators side by side."""

    kind: str
    """The table: phase_line, switch, transformer, regulator or admittance."""
    rows: tuple[int, ...]
    name: str
    from_bus: str
    to_bus: str
    phases: str


class Tree(NamedTuple):
    """Buses in depth-first order, the source bus first, and the branch that feeds each but the first."""

    bus_ids: tuple[str, ...]
    phases: tuple[str, ...]
    """The phases of each bus, a text."""
    parent: NDArray[np.intp]
    """Position of the bus that feeds bus k + 1, shape (n_bus - 1,)."""
    branches: tuple[Branch, ...]
    """Branch k feeds bus k + 1."""
    is_radial: bool


def three_phase_tree(network: Network) -> Tree:
    """Order the buses of checked tables.

    Raises
    ------
    FeederError
        For an island. On radial grids for a transformer or regulator that is fed at its to-side.
    """
    branches = _branches(network)
    phases: dict[str, str] = {}
    for bus, phase in zip(network.node.bus, network.node.phase, strict=True):
        phases[bus] = phases.get(bus, "") + LETTERS[phase - 1]
    buses, source = list(phases), network.source.bus[0]
    spanning = _spanning(branches)
    is_radial = len(spanning) == len(branches) and not len(network.admittance)
    branches = spanning
    ends = [[getattr(b, end) for b in branches] for end in ("from_bus", "to_bus")]
    order, parent, branch, _ = orient(network.name, source, buses, *ends)
    index = depth_first(parent)
    bus_ids = tuple(buses[i] for i in order[index.order])
    fed_by = tuple(branches[branch[i - 1]] for i in index.order[1:])
    is_radial &= all(one.phases == phases[bus] for bus, one in zip(bus_ids[1:], fed_by, strict=True))
    is_radial &= all(map(network.regulator.is_wye, range(len(network.regulator))))
    for bus, one in zip(bus_ids[1:], fed_by, strict=True):
        if is_radial and one.kind in ("transformer", "regulator") and one.to_bus != bus:
            raise FeederError(
                f"feeder {network.name!r}: {one.kind} {one.name} is fed at its to_bus {one.to_bus!r}; its from_bus "
                f"must be on the side of the source {source!r}"
            )
    return Tree(bus_ids, tuple(phases[bus] for bus in bus_ids), index.parent[1:], fed_by, is_radial)


def _spanning(branches: list[Branch]) -> list[Branch]:
    """The first branches that connect all that is connected, without a loop."""
    part: dict[str, str] = {}

    def root(bus: str) -> str:
        while part.setdefault(bus, bus) != bus:
            part[bus] = part[part[bus]]
            bus = part[bus]
        return bus

    kept = []
    for branch in branches:
        one, other = root(branch.from_bus), root(branch.to_bus)
        if one != other:
            part[one] = other
            kept.append(branch)
    return kept


def _branches(network: Network) -> list[Branch]:
    branches = []
    for kind in ("phase_line", "switch", "transformer"):
        table = getattr(network, kind)
        rows = zip(table.name, table.from_bus, table.to_bus, table.phases, strict=True)
        for row, ends in enumerate(rows):
            if kind != "switch" or table.state[row] == "closed":
                branches.append(Branch(kind, (row,), *ends))
    regulator = network.regulator
    banks: dict[tuple[str, str], list[int]] = {}
    for row, pair in enumerate(zip(regulator.from_bus, regulator.to_bus, strict=True)):
        banks.setdefault(pair, []).append(row)
    for (i, j), rows in banks.items():
        names = ", ".join(regulator.name[row] for row in rows)
        phases = "".join(regulator.phases[row] for row in rows)
        if len(set(phases)) < len(phases) and all(map(regulator.is_wye, rows)):
            raise FeederError(
                f"feeder {network.name!r}: regulators {names}: phases is {phases!r} from {i} to {j}; give each phase "
                "one regulator"
            )
        branches.append(Branch("regulator", tuple(rows), names, i, j, "".join(sorted(set(phases)))))
    for row, (name, nodes) in enumerate(zip(network.admittance.name, network.admittance.nodes, strict=True)):
        first, *others = dict.fromkeys(bus for bus, _ in node_names(nodes))
        branches += [Branch("admittance", (row,), name, first, other, "") for other in others]
    return branches
