"""A three-phase feeder cut into zones of buses that only lines and closed switches join, each zone fed by one branch.

The voltage of a node is that of the zone's first bus on its phase minus a sum over all nodes of the zone. Each term is
the impedance that the paths of both nodes share, times the current of the other node. This is one product with a
matrix. Regulators and transformers separate zones. They are few, so a sweep is a few products on any device.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.unbalanced.plan import LINE, plan_of


class Zone(NamedTuple):
    """One zone; matrices act on rows from the left, so the rows are the leading dimensions."""

    nodes: np.ndarray
    """Its nodes, those of its first bus first, (n,)."""
    senders: np.ndarray
    """Nodes that feed those of its first bus, (size,); none for the source's zone."""
    enter: np.ndarray
    """0/1: which nodes have the phase of each of its first bus's, (size, n)."""
    z: np.ndarray
    """Shared impedance of the paths of two nodes within the zone, p.u., (n, n)."""
    through: np.ndarray
    """0/1: 1 in row i and column j where the current of node i comes through the branch to node j, (n, n)."""
    a: np.ndarray
    """Ratio of the branch that feeds it, (size, size), of a regulator at neutral."""
    b: np.ndarray
    """Impedance of the branch that feeds it, (size, size)."""
    regulator: np.ndarray | None
    """Row of the regulator of each phase, (size,), or None."""


@cached_on_owner
def zones_of(feeder: ThreePhaseFeeder) -> tuple[Zone, ...]:
    """Cut a feeder into zones, from the source on, each after the one that feeds it."""
    kind = plan_of(feeder).kind
    first = [0] + [i for i in range(1, feeder.n_bus) if kind[i] != LINE]
    members: dict[int, list[int]] = {i: [i] for i in first}
    zone_of = {0: 0}
    for i in range(1, feeder.n_bus):
        zone_of[i] = i if i in members else zone_of[int(feeder.parent[i - 1])]
        if i not in members:
            members[zone_of[i]].append(i)
    return tuple(_zone(feeder, members[i]) for i in first)


def _zone(feeder: ThreePhaseFeeder, buses: list[int]) -> Zone:
    nodes = np.concatenate([np.arange(feeder.first_node[i], feeder.first_node[i + 1]) for i in buses])
    place = {int(node): k for k, node in enumerate(nodes)}
    root, n = buses[0], len(nodes)
    size = int(feeder.first_node[root + 1] - feeder.first_node[root])
    through, z = np.eye(n), np.zeros((n, n), np.complex128)
    for k in range(n - 1, size - 1, -1):  # what comes through a node's branch comes through its feeder's
        through[:, place[int(feeder.node_parent[nodes[k]])]] += through[:, k]
    for i in buses[1:]:
        positions = [place[node] for node in range(feeder.first_node[i], feeder.first_node[i + 1])]
        below, m = through[:, positions], len(positions)
        z += below @ feeder.branches.b[i, :m, :m] @ below.T
    tapped = feeder.branches.regulator[root, :size]
    return Zone(
        nodes=nodes,
        senders=feeder.node_parent[nodes[:size]] if root else np.zeros(0, np.intp),
        enter=through[:, :size].T.copy(),
        z=z,
        through=through,
        a=feeder.branches.a[root, :size, :size],
        b=feeder.branches.b[root, :size, :size],
        regulator=tapped if (tapped >= 0).any() else None,
    )
