"""Comparison of the tables' rows with the primitive admittance matrices of the elements that they are.

A row that does not reproduce OpenDSS's matrix of its elements is found here, whatever property of them it misses.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from dcgrid_env.apps.importers.opendss.dss_admittances import admittance_at_nodes
from dcgrid_env.apps.importers.opendss.dss_circuit import DssCircuit
from dcgrid_env.apps.importers.opendss.joints import Letters, Node
from dcgrid_env.grid.network import Network
from dcgrid_env.grid.nodal_matrices import (
    GROUND,
    Coupler,
    Element,
    elements_of,
    leg_element,
    line_impedances,
    switch_impedances,
)
from dcgrid_env.grid.three_phase_legs import capacitor_legs, core_legs
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA
from dcgrid_env.grid.three_phase_tables import LETTERS

CLOSE = 1e-7
"""Largest difference of an entry, as a share of the mean of the entries on the diagonal in its row and column."""
SOLVABLE_PU = 1e-9
"""Least impedance of a branch, p.u., with which OpenDSS is compared. Of 1e-11 its voltages are some 1e-7 p.u. off."""
_LEAST_S = 2e-9
"""Admittance that no voltage depends on, S, such as the charging of a switch."""


def unlike_elements(
    circuit: DssCircuit,
    letters: Letters,
    network: Network,
    members: Mapping[str, Sequence[tuple[str, ...]]],
    between: Container[str],
) -> list[str]:
    """The elements, as class.name, whose rows have another admittance matrix than OpenDSS at the present taps.

    Parameters
    ----------
    circuit, letters
        The circuit and the letters of its nodes.
    network
        The tables.
    members
        Elements that each row of a table is, by table and row.
    between
        Buses that the tables have between a transformer and its regulator.
    """
    node = network.node
    places = {(bus, LETTERS[phase - 1]): k for k, (bus, phase) in enumerate(zip(node.bus, node.phase, strict=True))}
    inner = {k for (bus, _), k in places.items() if bus in between}
    base_kv = np.array(node.base_kv_ln)
    unlike: list[str] = []
    for elements, parts in _groups(list(_parts(network, places, base_kv)), members):
        ours = _matrix(network, parts, inner)
        theirs = _matrix(network, list(_of_opendss(circuit, letters, elements, places, base_kv)), set())
        if not _alike(ours, theirs, base_kv):
            unlike += elements
    return unlike


def impedances_to_raise(network: Network, members: Mapping[str, Sequence[tuple[str, ...]]]) -> dict[str, float]:
    """Elements, as class.name, of so little impedance that rounding moves OpenDSS's voltages, and factors to raise it.

    ``members`` are the elements of each row, by table and row.
    """
    sizes = {"phase_line": line_impedances(network), "switch": switch_impedances(network)}
    return {
        full: SOLVABLE_PU / z_pu
        for kind, of_table in sizes.items()
        for z_pu, of_row in zip(of_table, members[kind], strict=True)
        for full in of_row
        if 0.0 < z_pu < SOLVABLE_PU
    }


def _parts(network: Network, places: Mapping[Node, int], base_kv: NDArray[np.float64]) -> Iterator[Element | Coupler]:
    """The elements and couplers of all rows, per unit."""
    nodes: dict[str, dict[str, int]] = {}
    for (bus, letter), k in places.items():
        nodes.setdefault(bus, {})[letter] = k
    elements, couplers = elements_of(network, nodes, base_kv)
    yield from (*elements, *couplers)
    bases = dict(zip(network.node.bus, network.node.base_kv_ln, strict=True))
    of_kind = {"capacitor": capacitor_legs(network, nodes, bases), "core": core_legs(network, nodes, bases)}
    for kind, legs in of_kind.items():
        for k, row in enumerate(legs.row.tolist()):
            if kind == "core" or network.capacitor.state[row] == "on":
                yield leg_element(kind, row, legs, k)


def _groups(
    parts: Sequence[Element | Coupler], members: Mapping[str, Sequence[tuple[str, ...]]]
) -> Iterator[tuple[list[str], list[Element | Coupler]]]:
    """Elements of which some rows are, with the parts of these rows."""
    names = list(dict.fromkeys(full for of_table in members.values() for of_row in of_table for full in of_row))
    number = {full: k for k, full in enumerate(names)}
    pairs = [(number[row[0]], number[full]) for of_table in members.values() for row in of_table for full in row]
    one, other = (np.array(side, int) for side in zip(*pairs, strict=True)) if pairs else (np.zeros(0, int),) * 2
    _, group = connected_components(coo_matrix((np.ones(len(one)), (one, other)), (len(names), len(names))), False)
    groups: dict[int, tuple[list[str], list[Element | Coupler]]] = {}
    for full, k in zip(names, group.tolist(), strict=True):
        groups.setdefault(k, ([], []))[0].append(full)
    for part in parts:
        groups[int(group[number[members[part.kind][part.row][0]]])][1].append(part)
    yield from groups.values()


def _of_opendss(
    circuit: DssCircuit,
    letters: Letters,
    elements: Sequence[str],
    places: Mapping[Node, int],
    base_kv: NDArray[np.float64],
) -> Iterator[Element]:
    """The matrices of some elements by OpenDSS, per unit; a node that the tables lack has no voltage."""
    for full in elements:
        kind, _, name = full.partition(".")
        circuit.activate(kind, name)
        admittance = admittance_at_nodes(circuit, letters)
        if admittance is None:
            continue
        kept = [k for k, node in enumerate(admittance[0]) if node in places]
        nodes = tuple(places[admittance[0][k]] for k in kept)
        per_siemens = np.outer(base_kv[list(nodes)], base_kv[list(nodes)]) * 1000.0 / PHASE_BASE_KVA
        yield Element(kind, 0, nodes, admittance[1][np.ix_(kept, kept)] * per_siemens, np.full(len(nodes), np.nan))


def _matrix(
    network: Network, parts: Sequence[Element | Coupler], inner: Container[int]
) -> tuple[list[int], NDArray[np.complex128]]:
    """The sum of parts over their nodes, without inner nodes and the currents of couplers."""
    couplers = [part for part in parts if isinstance(part, Coupler)]
    elements = [part for part in parts if isinstance(part, Element)]
    used = {node for part in elements for node in part.nodes}
    used |= {node for coupler in couplers for node in coupler.ends if node != GROUND}
    order = [*sorted(node for node in used if node not in inner), *sorted(node for node in used if node in inner)]
    place, n = {node: k for k, node in enumerate(order)}, len(order)
    y = np.zeros((n + len(couplers), n + len(couplers)), np.complex128)
    for part in elements:
        rows = [place[node] for node in part.nodes]
        y[np.ix_(rows, rows)] += part.y
    for k, coupler in enumerate(couplers, start=n):
        table, row = network.regulator, coupler.regulator
        ratio = 1.0 if row < 0 else 1.0 + table.tap_step[row] * table.tap[row]
        for node, value in zip(coupler.ends, (ratio, -ratio, -1.0, 1.0), strict=True):
            if node != GROUND:
                y[place[node], k] += value
                y[k, place[node]] += value
        y[k, k] = -(ratio**2) * coupler.z
    outer = sum(node not in inner for node in order)
    if outer == len(y):
        return order, y
    try:
        y = y[:outer, :outer] - y[:outer, outer:] @ np.linalg.solve(y[outer:, outer:], y[outer:, :outer])
    except np.linalg.LinAlgError:
        y = np.full((outer, outer), np.nan + 0j)
    return order[:outer], y


def _alike(
    one: tuple[list[int], NDArray[np.complex128]],
    other: tuple[list[int], NDArray[np.complex128]],
    base_kv: NDArray[np.float64],
) -> bool:
    order = list(dict.fromkeys((*one[0], *other[0])))
    full = np.zeros((2, len(order), len(order)), np.complex128)
    for k, (nodes, y) in enumerate((one, other)):
        rows = [order.index(node) for node in nodes]
        full[k][np.ix_(rows, rows)] = y
    size = np.sqrt(np.abs(np.diagonal(full[1])))
    kv = base_kv[order]
    least = _LEAST_S * np.outer(kv, kv) * 1000.0 / PHASE_BASE_KVA
    return bool((np.abs(full[0] - full[1]) <= CLOSE * np.outer(size, size) + least).all())
