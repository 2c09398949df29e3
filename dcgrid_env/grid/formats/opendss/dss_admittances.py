"""Elements that no other table can hold, as OpenDSS's primitive admittance matrices.

These are transformers with a centre tap, with three windings, in open wye and open delta, and with a floating star or a
neutral impedance. They also are lines with neutral conductors, changing or open phases, reactors, series capacitors and
fault resistances.
"""

from __future__ import annotations

import math

import numpy as np

from dcgrid_env.grid.formats.opendss.dss_circuit import DssCircuit
from dcgrid_env.grid.formats.opendss.joints import Joint, Letters, Node

_SAME = 1e-9
"""Difference of two entries of a symmetric matrix, as a share of its largest."""
_OPEN_S = 2e-12
"""Admittance, S, up to which a conductor is open. OpenDSS leaves 1e-12 there."""


def admittance_joint(
    circuit: DssCircuit, letters: Letters, kind: str, name: str, rating_a: float = math.nan
) -> Joint | str | None:
    """The row of an element; None for one that draws and connects nothing, or what is wrong."""
    circuit.activate(kind, name)
    conductors = [(end.bus, node) for end in circuit.terminals() for node in end.nodes]
    y = circuit.admittance()
    if len(y) != len(conductors) or not np.isfinite(y).all():
        return "OpenDSS gives no admittance matrix of all its conductors"
    if np.abs(y - y.T).max() > _SAME * np.abs(y).max():
        return "its admittance matrix is not symmetric: it is an active element"
    places: dict[Node, list[int]] = {}
    for k, (bus, node) in enumerate(conductors):
        if node and np.abs(y[k]).max() > _OPEN_S:
            places.setdefault((bus, letters[node]), []).append(k)
    if not places:
        return None
    joined = np.zeros((len(places), len(y)))
    for row, at in enumerate(places.values()):
        joined[row, at] = 1.0
    return joint_of(name, kind, tuple(places), joined @ y @ joined.T, rating_a)


def joint_of(name: str, kind: str, nodes: tuple[Node, ...], y: np.ndarray, rating_a: float) -> Joint:
    """The row of an element with this matrix over these nodes."""
    upper = (0.5 * (y + y.T))[np.triu_indices(len(nodes))]
    values = {
        "kind": kind, "nodes": " ".join(f"{bus}.{letter}" for bus, letter in nodes),
        "g_s": tuple(upper.real.tolist()), "b_s": tuple(upper.imag.tolist()), "rating_a": rating_a,
    }  # fmt: skip
    ends = tuple(dict.fromkeys(bus for bus, _ in nodes))
    return Joint("admittance", f"{kind}.{name}", ends, "", True, values, nodes)
