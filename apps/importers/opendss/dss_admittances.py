"""Elements that no other table can hold, as OpenDSS's primitive admittance matrices.

These are transformers with a centre tap, with three windings, in open wye and open delta, and with a floating star or a
neutral impedance. They also are lines with neutral conductors, changing or open phases, reactors, series capacitors and
fault resistances.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.apps.importers.opendss.joints import Joint, Letters, Node, Supply
from dcgrid_env.grid.three_phase_matrices import symmetric

_SAME = 1e-9
"""Difference of two entries of a symmetric matrix, as a share of its largest."""
_OPEN_S = 2e-12
"""Admittance, S, up to which a conductor is open. OpenDSS leaves 1e-12 there."""


def admittance_joint(
    circuit: DssCircuit, letters: Letters, kind: str, name: str, rating_a: float = math.nan
) -> Joint | str | None:
    """The row of an element; None for one that draws and connects nothing, or what is wrong."""
    circuit.activate(kind, name)
    at_nodes = admittance_at_nodes(circuit, letters)
    if at_nodes is None:
        return "OpenDSS gives no admittance matrix of all its conductors"
    nodes, y = at_nodes
    if not nodes:
        return None
    if np.abs(y - y.T).max() > _SAME * np.abs(y).max():
        return "its admittance matrix is not symmetric: it is an active element"
    return joint_of(name, kind, nodes, y, rating_a)


def admittance_at_nodes(
    circuit: DssCircuit, letters: Letters
) -> tuple[tuple[Node, ...], NDArray[np.complex128]] | None:
    """The nodes of the active element and its admittance matrix, S, over them; None if OpenDSS gives no matrix.

    Conductors at one node are one, and those that are open or grounded are left out.
    """
    conductors = [(end.bus, node) for end in circuit.terminals() for node in end.nodes]
    y = circuit.admittance()
    if len(y) != len(conductors) or not np.isfinite(y).all():
        return None
    places: dict[Node, list[int]] = {}
    for k, (bus, node) in enumerate(conductors):
        if node and np.abs(y[k]).max() > _OPEN_S:
            places.setdefault((bus, letters[node]), []).append(k)
    joined = np.zeros((len(places), len(y)))
    for row, conductors_there in enumerate(places.values()):
        joined[row, conductors_there] = 1.0
    return tuple(places), joined @ y @ joined.T


def joint_of(name: str, kind: str, nodes: tuple[Node, ...], y: np.ndarray, rating_a: float) -> Joint:
    """The row of an element with this matrix over these nodes."""
    upper = (0.5 * (y + y.T))[np.triu_indices(len(nodes))]
    values = {
        "kind": kind, "nodes": " ".join(f"{bus}.{letter}" for bus, letter in nodes),
        "g_s": tuple(upper.real.tolist()), "b_s": tuple(upper.imag.tolist()), "rating_a": rating_a,
    }  # fmt: skip
    ends = tuple(dict.fromkeys(bus for bus, _ in nodes))
    size = np.sqrt(np.abs(np.diag(y)))
    n, part = connected_components(np.abs(y) > np.maximum(_OPEN_S, _SAME * np.outer(size, size)), directed=False)
    parts = tuple(tuple(node for node, k in zip(nodes, part, strict=True) if k == one) for one in range(n))
    full = f"{kind}.{name}"
    return Joint("admittance", full, ends, "", True, values, nodes, parts, (full,))


def part_with_supply(joint: Joint, supply: Supply, report: Report) -> Joint:
    """An admittance over its nodes that have supply; it connects the others, at 0 V, with none of them."""
    kept = [k for k, node in enumerate(joint.nodes) if supply.has([node])]
    if len(kept) == len(joint.nodes):
        return joint
    kind, _, name = joint.name.partition(".")
    others = ", ".join(f"{bus}.{letter}" for bus, letter in joint.nodes if not supply.has([(bus, letter)]))
    report.add("nothing lost", kind, name, f"it connects {others} with no node that has supply: they are left out")
    y = symmetric(joint.values["g_s"], joint.values["b_s"])[np.ix_(kept, kept)]
    nodes = tuple(joint.nodes[k] for k in kept)
    return joint_of(name, kind, nodes, y, joint.values["rating_a"])
