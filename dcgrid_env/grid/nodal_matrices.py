"""Nodal admittances of a three-phase feeder that is not radial, per unit.

Y V is the current that linear elements draw at each node, for voltages V to ground. Regulators and switches may have
no impedance, or one so small that differences of voltages would be lost in rounding; so may lines (``NEAR_ZERO``). Each
of their phases, a *coupler*, adds an unknown, the current i that it brings to the side that it feeds, and a row. From
the winding f to the winding t with the ratio r, 1 for a switch or line, and the impedance z at the neutral tap

    V_t = r V_f - r^2 z i        with the draw -i at t and r i at f

The couplers of a line have mutual impedances in addition. A winding is from a node to ground or between two nodes. Per
unit is that of ``three_phase_matrices``, by node.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Container, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from dcgrid_env.grid.network import Network
from dcgrid_env.grid.three_phase_checks import node_names
from dcgrid_env.grid.three_phase_legs import Legs, chosen
from dcgrid_env.grid.three_phase_matrices import PHASE_BASE_KVA, symmetric, transformer_impedance, winding_shunts
from dcgrid_env.grid.topology import FeederError, listed

GROUND = -1
_PER_SIEMENS = 1000.0 / PHASE_BASE_KVA  # times both base voltages in kV
NEAR_ZERO = 1e-5
"""Impedance of a line, as a share of the median of all lines and transformers, below which its phases are couplers.

Rounding of the nodal equations moves voltages by about 1e-16 p.u. over this share.
"""
Nodes = dict[str, dict[str, int]]
"""Node by bus and letter."""


class NodalMatrices(NamedTuple):
    """Matrices over the nodes of a feeder, and what feeds each of them."""

    y: csr_matrix
    """Admittance of all elements but the source, couplers, legs, capacitors and cores, (n_node, n_node), symmetric."""
    source_y: NDArray[np.complex128]
    """Admittance of the source's impedance, (3, 3), at the first three nodes."""
    coupler_ends: NDArray[np.intp]
    """Nodes of the windings f and t of each coupler, two each, -1 for ground, (n_coupler, 4)."""
    coupler_z: NDArray[np.complex128]
    """Impedance at the neutral tap, (n_coupler,)."""
    coupler_regulator: NDArray[np.intp]
    """Row of the regulators' table, -1 for a switch or line, (n_coupler,)."""
    coupler_mutual: csr_matrix
    """Impedances between the couplers of a line, (n_coupler, n_coupler), symmetric, nothing on its diagonal."""
    carrying: Legs
    """Legs that alone connect a node with the source, or a neutral with it more than with ground.

    Their impedances at rated power are in ``y``. Cores draw the opposite, so the legs themselves count.
    """
    feed: csr_matrix
    """The current brought to each node by what feeds it, from the voltages of all nodes, (n_node, n_node)."""
    feed_coupler: NDArray[np.intp]
    """The coupler that feeds each node, -1 for none, (n_node,). The source feeds its own three. At the conductor where
    several windings end it is one of theirs."""
    feed_sign: NDArray[np.float64]
    """1 where its current comes to the node, -1 where it goes: at the second end of a winding or at f, (n_node,)."""
    parent: NDArray[np.intp]
    """Node that feeds each node, -1 at the source and for nodes that only elements to ground reach, (n_node,)."""
    regulator: NDArray[np.intp]
    """Row of the regulator that feeds each node, -1 where none does, (n_node,)."""
    z_pu: NDArray[np.float64]
    """Magnitude of the impedance of what feeds each node, (n_node,)."""
    rating_a: NDArray[np.float64]
    """Rated current of what feeds each node, A, NaN where it is not known, (n_node,)."""


class Element(NamedTuple):
    """A linear element: a row of a table, or a part of one."""

    kind: str
    """The table."""
    row: int
    nodes: tuple[int, ...]
    y: NDArray[np.complex128]
    """Primitive admittance matrix, p.u."""
    rating_a: NDArray[np.float64]
    """Rated current at each node if it is the one that is fed, A."""


class Coupler(NamedTuple):
    """A coupler: a phase of a switch or line, or a winding of a regulator."""

    kind: str
    """The table."""
    row: int
    ends: tuple[int, int, int, int]
    z: complex
    rating_a: float
    mutual: tuple[complex, ...] = ()
    """Impedances to the couplers of the same line before it."""

    @property
    def regulator(self) -> int:
        """Row of the regulators' table, -1 for another coupler."""
        return self.row if self.kind == "regulator" else -1


def nodal_matrices(network: Network, nodes: Nodes, base_kv: NDArray[np.float64], legs: Legs) -> NodalMatrices:
    """Compile checked tables; ``base_kv`` is the base voltage of each node, line to neutral, (n_node,).

    ``legs`` are those of loads and capacitors. Some may alone connect a node, such as the neutral of a star.

    Raises
    ------
    FeederError
        Naming nodes that no element connects to the source, and the elements there.
    """
    n = len(base_kv)
    elements, couplers = elements_of(network, nodes, base_kv, NEAR_ZERO * median_impedance(network))
    source = network.source
    z = (np.array(source.r_ohm[0]) + 1j * np.array(source.x_ohm[0])) / (base_kv[0] ** 2 * _PER_SIEMENS)
    ends = np.array([c.ends for c in couplers], np.intp).reshape(-1, 4)
    feeds = _feeding_paths(elements, couplers, n)
    isolated = np.array([feed is None for feed in feeds] + [False])
    isolated[_weakly_grounded(elements, nodes, legs, n)] = True
    carrying = chosen(legs, isolated[legs.node] | isolated[legs.other])
    if len(carrying.row):
        elements += [leg_element("leg", k, carrying, k) for k in range(len(carrying.row))]
        feeds = _feeding_paths(elements, couplers, n)
    lost = [(bus, letter) for bus, of_bus in nodes.items() for letter, node in of_bus.items() if not feeds[node]]
    if lost:
        there = elements_at(network, {bus for bus, _ in lost})
        raise FeederError(
            f"feeder {network.name!r}: no element connects the nodes {listed(['.'.join(one) for one in lost])} to the "
            f"source; at their buses are {listed(there) if there else 'no elements'}; add one, or turn the regulator "
            "whose to_bus is on the side of the source"
        )
    return NodalMatrices(
        y=_sum([(e.nodes, e.y) for e in elements], n),
        source_y=_inverse(network, "source", z),
        coupler_ends=ends,
        coupler_z=np.array([c.z for c in couplers], np.complex128),
        coupler_regulator=np.array([c.regulator for c in couplers], np.intp),
        coupler_mutual=_mutual(couplers),
        carrying=carrying,
        **_feeds(elements, couplers, feeds, n),
    )


def _weakly_grounded(elements: Sequence[Element], nodes: Nodes, legs: Legs, n: int) -> NDArray[np.intp]:
    """Conductors other than phases that the elements connect with ground by less than the legs there would."""
    others = [node for of_bus in nodes.values() for letter, node in of_bus.items() if letter > "c"]
    if not others:
        return np.zeros(0, np.intp)
    y = _sum([(e.nodes, e.y) for e in elements], n)[others][:, others]
    of_legs = _sum([(e.nodes, e.y) for k in range(len(legs.row)) for e in (leg_element("leg", k, legs, k),)], n)
    number, part = connected_components(abs(y), directed=False)
    to_ground, by_legs = np.zeros(number, np.complex128), np.zeros(number)
    np.add.at(to_ground, part, np.asarray(y.sum(axis=1)).ravel())
    np.add.at(by_legs, part, np.abs(of_legs.diagonal()[others]))
    return np.array(others)[(np.abs(to_ground) < by_legs)[part]]


def elements_of(
    network: Network, nodes: Nodes, base_kv: NDArray[np.float64], least_z_pu: float = 0.0
) -> tuple[list[Element], list[Coupler]]:
    """The linear elements of checked tables other than legs, and the couplers: lines below an impedance among them."""
    elements: list[Element] = []
    couplers: list[Coupler] = []
    _lines(network, nodes, base_kv, least_z_pu, elements, couplers)
    elements += [*_transformers(network, nodes, base_kv), *_admittances(network, nodes, base_kv)]
    lines, couplers = couplers, [*_regulators(network, nodes, base_kv, elements), *_switches(network, nodes, base_kv)]
    return elements, couplers + lines


def leg_element(kind: str, row: int, legs: Legs, k: int) -> Element:
    """A leg of constant impedance as an element."""
    y = complex(legs.p_kw[k], -legs.q_kvar[k]) / PHASE_BASE_KVA / float(legs.rated_pu[k]) ** 2
    nodes = tuple(node for node in (int(legs.node[k]), int(legs.other[k])) if node != GROUND)
    between = np.array([[1.0, -1.0], [-1.0, 1.0]])[: len(nodes), : len(nodes)]
    return Element(kind, row, nodes, y * between, np.full(len(nodes), math.nan))


def elements_at(network: Network, buses: Container[str]) -> list[str]:
    """Names of the elements at some buses, each with its kind."""
    elements = []
    for kind in ("phase_line", "switch", "transformer", "regulator", "phase_load", "capacitor", "core"):
        table: Any = getattr(network, kind)
        ends = [getattr(table, field) for field in ("from_bus", "to_bus", "bus") if hasattr(table, field)]
        word = "transformer" if kind == "core" else kind.removeprefix("phase_")
        for name, *of_row in zip(table.name, *ends, strict=True):
            elements += [f"{word} {name}"] if any(bus in buses for bus in of_row) else []
    for name, named in zip(network.admittance.name, network.admittance.nodes, strict=True):
        if any(bus in buses for bus, _ in node_names(named)):
            elements.append(name.replace(".", " ", 1))
    return list(dict.fromkeys(elements))


def line_impedances(network: Network) -> list[float]:
    """Largest entry of the impedance matrix of each line, p.u."""
    line, bases = network.phase_line, _base_ohms(network)
    return [
        float(np.nanmax(np.abs(np.array(r, float) + 1j * np.array(x, float)))) / bases[bus]
        for r, x, bus in zip(line.r_ohm, line.x_ohm, line.to_bus, strict=True)
    ]


def switch_impedances(network: Network) -> list[float]:
    """Impedance of each switch, p.u."""
    switch, bases = network.switch, _base_ohms(network)
    return [
        abs(complex(r, x)) / bases[bus] for r, x, bus in zip(switch.r_ohm, switch.x_ohm, switch.to_bus, strict=True)
    ]


def median_impedance(network: Network) -> float:
    """Median impedance of the lines and transformers, p.u.; 0 where there are none."""
    transformer, bases = network.transformer, _base_ohms(network)
    units = [abs(transformer_impedance(transformer, k)) / bases[bus] for k, bus in enumerate(transformer.to_bus)]
    sizes = line_impedances(network) + units
    return float(np.median(sizes)) if sizes else 0.0


def _base_ohms(network: Network) -> dict[str, float]:
    return {bus: kv**2 * _PER_SIEMENS for bus, kv in zip(network.node.bus, network.node.base_kv_ln, strict=True)}


def _mutual(couplers: Sequence[Coupler]) -> csr_matrix:
    entries = [
        (k, k - len(coupler.mutual) + j, z)
        for k, coupler in enumerate(couplers)
        for j, z in enumerate(coupler.mutual)
        if z
    ]
    row, column, z = (np.array(part) for part in zip(*entries, strict=True)) if entries else (np.zeros(0, int),) * 3
    below = csr_matrix((z.astype(np.complex128), (row, column)), (len(couplers), len(couplers)))
    return _frozen((below + below.T).tocsr())


def _inverse(network: Network, element: str, z: NDArray[Any]) -> NDArray[Any]:
    """Admittance matrix of an impedance matrix; FeederError for one without an inverse."""
    with np.errstate(all="ignore"), contextlib.suppress(np.linalg.LinAlgError):
        y = np.linalg.inv(z)
        if np.isfinite(y).all():
            return y
    raise FeederError(
        f"feeder {network.name!r}: {element}: its impedance is 0 or singular, which a feeder that is not radial "
        "cannot have; give a small one, or use a switch"
    )


def _sum(parts: Sequence[tuple[Sequence[int], NDArray[np.complex128]]], n: int) -> csr_matrix:
    rows = [np.repeat(nodes, len(nodes)) for nodes, _ in parts]
    columns = [np.tile(nodes, len(nodes)) for nodes, _ in parts]
    values = [y.ravel() for _, y in parts]
    if not parts:
        return csr_matrix((n, n), dtype=np.complex128)
    flat = np.concatenate(values)
    some = flat != 0.0
    matrix = csr_matrix((flat[some], (np.concatenate(rows)[some], np.concatenate(columns)[some])), (n, n))
    matrix.sum_duplicates()
    return _frozen(matrix)


def _frozen(matrix: csr_matrix) -> csr_matrix:
    """The matrix with arrays that cannot be written to: results on feeders are shared."""
    for array in (matrix.data, matrix.indices, matrix.indptr):
        array.flags.writeable = False
    return matrix


def _per_unit(y_s: NDArray[Any], nodes: Sequence[int], base_kv: NDArray[np.float64]) -> NDArray[Any]:
    kv = base_kv[list(nodes)]
    return y_s * np.outer(kv, kv) * _PER_SIEMENS


def _two_sided(y_s: NDArray[Any], through: NDArray[Any], shunts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Admittance of a branch V_to = through V_from - Z I with y = 1 / Z at its to-side, and shunts at its ends."""
    from_y, mutual = through.T @ y_s @ through, -through.T @ y_s
    return np.block([[from_y + shunts[0], mutual], [mutual.T, y_s + shunts[1]]])


def _lines(
    network: Network,
    nodes: Nodes,
    base_kv: NDArray[np.float64],
    least_z_pu: float,
    elements: list[Element],
    couplers: list[Coupler],
) -> None:
    """Add the lines to the elements, or those of less impedance to the couplers."""
    table = network.phase_line
    rated = table.rating_a or (math.nan,) * len(table)
    for row, phases in enumerate(table.phases):
        columns, size = ["abc".index(phase) for phase in phases], len(phases)
        r, x, b_us = (np.array(m[row], float)[np.ix_(columns, columns)] for m in (table.r_ohm, table.x_ohm, table.b_us))
        half, z = 0.5e-6j * b_us, r + 1j * x
        ends = [nodes[bus][phase] for bus in (table.from_bus[row], table.to_bus[row]) for phase in phases]
        z_pu = z / (base_kv[ends[0]] ** 2 * _PER_SIEMENS)
        if np.abs(z_pu).max() < least_z_pu:
            couplers += [
                Coupler("phase_line", row, (i, GROUND, j, GROUND), z_pu[k, k], rated[row], tuple(z_pu[k, :k].tolist()))
                for k, (i, j) in enumerate(zip(ends[:size], ends[size:], strict=True))
            ]
            y = np.zeros((size, size), np.complex128)
        else:
            y = _inverse(network, f"line {table.name[row]}", z)
        y = _two_sided(y, np.eye(size), (half, half))
        if y.any():
            element = Element(
                "phase_line", row, tuple(ends), _per_unit(y, ends, base_kv), np.full(2 * size, rated[row])
            )
            elements.append(element)


def _switches(network: Network, nodes: Nodes, base_kv: NDArray[np.float64]) -> Iterator[Coupler]:
    table = network.switch
    rated = table.rating_a or (math.nan,) * len(table)
    for row, phases in enumerate(table.phases):
        z = complex(table.r_ohm[row], table.x_ohm[row])
        for phase in phases if table.state[row] == "closed" else "":
            i, j = nodes[table.from_bus[row]][phase], nodes[table.to_bus[row]][phase]
            yield Coupler("switch", row, (i, GROUND, j, GROUND), z / (base_kv[j] ** 2 * _PER_SIEMENS), rated[row])


def _transformers(network: Network, nodes: Nodes, base_kv: NDArray[np.float64]) -> Iterator[Element]:
    """Transformers by their windings; a delta leaves the zero sequence of its side to the other elements."""
    table = network.transformer
    rated = table.rating_kva or table.kva
    for row, phases in enumerate(table.phases):
        size, (kv_from, kv_to) = len(phases), (table.kv_ll_from[row], table.kv_ll_to[row])
        windings = (table.connection_from[row], table.connection_to[row])
        y = _inverse(network, f"transformer {table.name[row]}", np.eye(size) * transformer_impedance(table, row))
        through = np.eye(size)
        if windings == ("delta", "wye_grounded"):
            turned = np.roll(np.eye(3), -1 if table.shift_deg[row] < 0 else 1, axis=1)
            through = (np.eye(3) - turned) / math.sqrt(3.0)
        elif windings == ("delta", "delta"):
            y = y @ (np.eye(3) - np.ones((3, 3)) / 3.0)
        y = _two_sided(y, kv_to / kv_from * through, [1j * shunt for shunt in winding_shunts(table, row)])
        ends = [nodes[bus][phase] for bus in (table.from_bus[row], table.to_bus[row]) for phase in phases]
        amps = [rated[row] / (size * kv / math.sqrt(3.0)) for kv in (kv_from, kv_to) for _ in phases]
        yield Element("transformer", row, tuple(ends), _per_unit(y, ends, base_kv), np.array(amps))


def _admittances(network: Network, nodes: Nodes, base_kv: NDArray[np.float64]) -> Iterator[Element]:
    table = network.admittance
    rated = table.rating_a or (math.nan,) * len(table)
    for row, names in enumerate(table.nodes):
        ends = [nodes[bus][letter] for bus, letter in node_names(names)]
        y = _per_unit(symmetric(table.g_s[row], table.b_s[row]), ends, base_kv)
        yield Element("admittance", row, tuple(ends), y, np.full(len(ends), rated[row]))


def _regulators(
    network: Network, nodes: Nodes, base_kv: NDArray[np.float64], elements: list[Element]
) -> Iterator[Coupler]:
    table = network.regulator
    rated = table.rating_kva_per_phase or table.kva_per_phase
    for row in range(len(table)):
        base_ohm = table.kv_ln[row] ** 2 * 1000.0 / table.kva_per_phase[row]
        z_ohm = complex(table.r_percent[row], table.x_percent[row]) / 100.0 * base_ohm
        shunt_s = -0.5e-6j * table.antifloat_ppm[row] / base_ohm
        for at_from, at_to in table.windings(row):
            f = [nodes[table.from_bus[row]][letter] for letter in at_from]
            t = [nodes[table.to_bus[row]][letter] for letter in at_to]
            z = z_ohm / (base_kv[t[0]] ** 2 * _PER_SIEMENS)
            ends = (*f, *[GROUND] * (2 - len(f)), *t, *[GROUND] * (2 - len(t)))
            yield Coupler("regulator", row, (ends[0], ends[1], ends[2], ends[3]), z, rated[row] / table.kv_ln[row])
            for node in (*f, *t) if shunt_s else ():
                one = _per_unit(np.array([[shunt_s]]), (node,), base_kv)
                elements.append(Element("regulator", row, (node,), one, np.full(1, math.nan)))


def _neighbours(elements: Sequence[Element], couplers: Sequence[Coupler], n: int) -> list[list[tuple[int, int, float]]]:
    """Connections of each node: the other node, the element (a coupler as a negative number), and the admittance."""
    joined: list[list[tuple[int, int, float]]] = [[] for _ in range(n)]
    for k, coupler in enumerate(couplers):
        f, f_other, t, t_other = coupler.ends
        for i, j in ((f, t), (f_other, t_other), (t, t_other)):
            if GROUND not in (i, j) and i != j:
                joined[i].append((j, ~k, math.inf))
                if coupler.regulator < 0 or i == t:  # a regulator feeds its to-side alone
                    joined[j].append((i, ~k, math.inf))
    for k, element in enumerate(elements):
        strength = np.abs(element.y)
        for i, j in zip(*np.nonzero(np.triu(strength, 1)), strict=True):
            joined[element.nodes[i]].append((element.nodes[j], k, float(strength[i, j])))
            joined[element.nodes[j]].append((element.nodes[i], k, float(strength[i, j])))
    return joined


def _feeding_paths(
    elements: Sequence[Element], couplers: Sequence[Coupler], n: int
) -> list[tuple[int, int, float] | None]:
    """What feeds each node: the node before it, the element or coupler, and the admittance; None for a node without.

    Nodes are taken from the source on, those that are fewest elements away first. Of several ways to a node the one
    with the largest admittance counts, so that a phase comes from its own and not by the coupling between phases.
    """
    joined = _neighbours(elements, couplers, n)
    feeds: list[tuple[int, int, float] | None] = [(-1, -1, math.inf) if node < 3 else None for node in range(n)]
    frontier = [0, 1, 2]
    while frontier:
        candidates: dict[int, tuple[int, int, float]] = {}
        for i in frontier:
            for j, position, strength in joined[i]:
                if feeds[j] is None and (j not in candidates or strength > candidates[j][2]):
                    candidates[j] = (i, position, strength)
        for j, feed in candidates.items():
            feeds[j] = feed
        frontier = list(candidates)
    return feeds


def _feeds(elements: Sequence[Element], couplers: Sequence[Coupler], feeds: list[Any], n: int) -> dict[str, Any]:
    rows: list[tuple[int, int, complex]] = []
    coupler, regulator = np.full(n, -1, np.intp), np.full(n, -1, np.intp)
    parent, z_pu, rating_a, sign = np.full(n, -1, np.intp), np.zeros(n), np.full(n, math.nan), np.ones(n)
    for node in range(3, n):
        parent[node], position, strength = feeds[node]
        if position < 0:
            link = couplers[~position]
            coupler[node], regulator[node], z_pu[node], rating_a[node] = (
                ~position,
                link.regulator,
                abs(link.z),
                link.rating_a,
            )
            sign[node] = 1.0 if link.ends[2] == node else -1.0
            continue
        element = elements[position]
        place = element.nodes.index(node)
        z_pu[node], rating_a[node] = 1.0 / strength, element.rating_a[place]
        rows += [(node, j, -y) for j, y in zip(element.nodes, element.y[place], strict=True) if y != 0.0]
    i, j, y = (np.array(column) for column in zip(*rows, strict=True)) if rows else (np.zeros(0, int),) * 3
    feed = _frozen(csr_matrix((y.astype(np.complex128), (i, j)), (n, n)))
    return {
        "feed": feed, "feed_coupler": coupler, "feed_sign": sign, "parent": parent, "regulator": regulator,
        "z_pu": z_pu, "rating_a": rating_a,
    }  # fmt: skip
