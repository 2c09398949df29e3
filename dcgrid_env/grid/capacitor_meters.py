"""Where the controls of capacitor banks measure current: at one end of a branch, from the figures of the power flow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.grid.network import Network
from dcgrid_env.grid.three_phase_nodes import FloatArray, IntArray, PhaseNodes
from dcgrid_env.grid.topology import FeederError


class Meter(NamedTuple):
    """Current I = sign x (current that its branch brings to a node) + j charging V, for each measured phase (n,)."""

    node: IntArray
    """Node at the end of the branch."""
    fed_node: IntArray
    """Node that the branch brings the current to: at the one end or the other."""
    sign: FloatArray
    """1 where the current leaves ``node`` for the fed one, -1 where ``node`` is the fed one."""
    charging_node: IntArray
    """Nodes of the line's phases at this end, (n, 3)."""
    charging_a_per_pu: FloatArray
    """Charging of this end's half of the line by a voltage of 1 p.u. there, (n, 3)."""


def meter_of(feeder: PhaseNodes, node_parent: IntArray, row: int) -> Meter | None:
    """The meter of a row of the capacitors' controls; None if it measures voltage alone.

    ``node_parent`` is the node that feeds each node, (n_node,).

    Raises
    ------
    FeederError
        If no branch joins its buses, or if it is at the end that feeds a transformer or regulator.
    """
    network, table = feeder.network, feeder.network.capacitor_control
    if table.measures[row] == "voltage":
        return None
    from_bus, to_bus = table.from_bus[row], table.to_bus[row]
    nodes, fed_nodes, signs = [], [], []
    for phase in table.phases[row]:
        node, other_node = feeder.nodes_of(from_bus, phase)[0], feeder.nodes_of(to_bus, phase)[0]
        leaves = node_parent[other_node] == node
        charged = _line_rows(network, from_bus, to_bus, phase)
        if not (charged if leaves else node_parent[node] == other_node):
            raise FeederError(
                f"feeder {feeder.name!r}: capacitor control {table.name[row]}: from_bus, to_bus are "
                f"{(from_bus, to_bus)!r}; give the ends of a line or switch of phase {phase}, or the secondary of a "
                "transformer and its primary"
            )
        nodes.append(node)
        fed_nodes.append(other_node if leaves else node)
        signs.append(1.0 if leaves else -1.0)
    return _with_charging(feeder, from_bus, to_bus, table.phases[row], nodes, fed_nodes, signs)


def _line_rows(network: Network, from_bus: str, to_bus: str, phase: str) -> list[tuple[str, int]]:
    """Rows of the lines and closed switches between two buses that have a phase."""
    found_rows = []
    for kind in ("phase_line", "switch"):
        table = getattr(network, kind)
        for row, ends in enumerate(zip(table.from_bus, table.to_bus, strict=True)):
            is_open = kind == "switch" and table.state[row] == "open"
            if set(ends) == {from_bus, to_bus} and phase in table.phases[row] and not is_open:
                found_rows.append((kind, row))
    return found_rows


def _with_charging(
    feeder: PhaseNodes,
    from_bus: str,
    to_bus: str,
    phases: str,
    nodes: list[int],
    fed_nodes: list[int],
    signs: list[float],
) -> Meter:
    network, base_v = feeder.network, 1000.0 * feeder.base_kv_ln[feeder.index(from_bus)]
    places = np.array(nodes, np.intp)[:, None].repeat(3, axis=1)
    charging = np.zeros((len(nodes), 3))
    for k, phase in enumerate(phases):
        for kind, row in _line_rows(network, from_bus, to_bus, phase):
            if kind == "phase_line":
                for column, other in enumerate("abc"):
                    if other in network.phase_line.phases[row]:
                        b_us = network.phase_line.b_us[row]["abc".index(phase)][column]
                        places[k, column] = feeder.nodes_of(from_bus, other)[0]
                        charging[k, column] += 0.5e-6 * b_us * base_v
    return Meter(np.array(nodes, np.intp), np.array(fed_nodes, np.intp), np.array(signs), places, charging)
