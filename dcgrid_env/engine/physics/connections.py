"""Nodes and legs that an agent at a bus is connected to, and the sensitivity of its voltage to power."""

from __future__ import annotations

from functools import partial
from math import lcm
from typing import NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices.phases import phases_of
from dcgrid_env.grid import AnyFeeder, Feeder, FeederError
from dcgrid_env.powerflow import Control, Sensitivity, linearise, own_sensitivity, sensitivity, sensitivity_by
from dcgrid_env.scenario.scenario import Scenario

N_NEIGHBOURS = 3
"""Number of neighbours that an agent observes with the scope `neighbours`."""


class Placement(NamedTuple):
    """Positions of the agents for observations; fixed for an episode, made by :func:`placement`."""

    r: Array
    """R_ii of each agent, in bands per MW, (row, n_agent), and X_ii in bands per Mvar."""
    x: Array
    nodes: Array
    """Nodes of the agents, as in ``Exogenous.nodes``, (row, n_agent, k)."""
    legs: Array
    """Legs of the agents, as in ``Exogenous.legs``, (row, n_agent, k)."""
    nearest: Array
    """Flat positions row * n_agent + agent of the nearest agents, int, (row, n_agent, k); k = 0 unless observed."""


@cached_on_owner
def nodes_by_bus(scenario: Scenario) -> np.ndarray:
    """Return the nodes of each agent at each bus, int, (n_agent, n_bus, k); node 0 if the bus is not allowed.

    An agent shares its power equally among its nodes and sees their mean voltage. ``k`` is the same for all: an agent
    of fewer nodes has each of them several times.
    """
    feeder = scenario.feeder
    if isinstance(feeder, Feeder):
        return np.broadcast_to(np.arange(feeder.n_bus)[:, None], (scenario.n_agents, feeder.n_bus, 1))
    agents = [phases for device in scenario.devices for phases in phases_of(device)]
    connected = {phases: [_nodes(feeder, bus, phases) for bus in range(feeder.n_bus)] for phases in set(agents)}
    k = lcm(*(len(nodes) for by_bus in connected.values() for nodes in by_bus))
    widened = {
        phases: np.array([np.tile(nodes, k // len(nodes)) for nodes in by_bus]) for phases, by_bus in connected.items()
    }
    return np.stack([widened[phases] for phases in agents])


class Connections(NamedTuple):
    """The different groups of nodes that agents may be connected to."""

    nodes: np.ndarray
    """Nodes of each group, int, (n_group, k), as in ``nodes_by_bus``."""
    group: np.ndarray
    """Group of each agent at each bus, int, (n_agent, n_bus)."""


@cached_on_owner
def connections(scenario: Scenario) -> Connections:
    """Return the groups of nodes of all agents at all buses."""
    by_bus = nodes_by_bus(scenario)
    if isinstance(scenario.feeder, Feeder):
        return Connections(by_bus[0], by_bus[..., 0])
    nodes, group = np.unique(by_bus.reshape(-1, by_bus.shape[-1]), axis=0, return_inverse=True)
    return Connections(nodes, group.reshape(by_bus.shape[:2]))


def _nodes(feeder: AnyFeeder, bus: int, phases: str | None) -> tuple[int, ...]:
    try:
        return feeder.nodes_at(bus, phases)
    except FeederError:
        return (0,)


@cached_on_owner
def own_distance(scenario: Scenario) -> np.ndarray:
    """Return R_ii and X_ii of each agent at each bus, p.u. per MW and Mvar, (n_agent, n_bus, 2).

    They are the rise of the agent's voltage with its injected power, by the scenario's model of the feeder. On a very
    large three-phase feeder they are 0 at buses where the agent cannot be placed.
    """
    if isinstance(scenario.feeder, Feeder):
        distances = _in_order(scenario, np.stack(own_sensitivity(scenario.model), axis=-1), 0)
        return np.broadcast_to(distances, (scenario.n_agents, *distances.shape))
    nodes = nodes_by_bus(scenario)
    if scenario.feeder.n_node > DENSE_MOST:
        return _own_distance_where_agents_may_stand(scenario, nodes)
    by_pair = partial(_pair_mean, nodes[..., :, None], nodes[..., None, :])
    return np.stack([by_pair(matrix) for matrix in believed_sensitivity(scenario)], axis=-1)


def _own_distance_where_agents_may_stand(scenario: Scenario, nodes: np.ndarray) -> np.ndarray:
    """``own_distance`` of a three-phase feeder row by row, without the matrices of all pairs of nodes."""
    feeder = scenario.feeder
    pairs: list[tuple[int, int]] = []
    first = 0
    for device in scenario.devices:
        for slot in range(device.count):
            buses = scenario.candidates if device.buses is None else [feeder.index(device.buses[slot])]
            pairs += [(first + slot, int(bus)) for bus in buses]
        first += device.count
    agent, bus = np.array(pairs, np.int64).reshape(-1, 2).T
    own_nodes, n_seen = nodes[agent, bus], nodes.shape[-1]
    distance = np.zeros((*nodes.shape[:2], 2))
    control = Control(capacitor_on=scenario.capacitor_connected)
    wanted = np.unique(own_nodes)
    for begin in range(0, len(wanted), _ROWS_AT_ONCE):
        source_nodes = wanted[begin : begin + _ROWS_AT_ONCE]
        slopes = linearise(
            feeder,
            feeder.p_load_kw,
            feeder.q_load_kvar,
            scenario.source_voltage_pu,
            control,
            nodes=source_nodes.tolist(),
        )
        pair, place = np.nonzero(np.isin(own_nodes, source_nodes))
        row = np.searchsorted(source_nodes, own_nodes[pair, place])
        for k, share in enumerate((scenario.sensing.r_model_share, scenario.sensing.x_model_share)):
            rise = share * slopes[k][row[:, None], own_nodes[pair]].sum(-1) / n_seen**2
            np.add.at(distance[..., k], (agent[pair], bus[pair]), rise)
    return distance


def believed_sensitivity(scenario: Scenario) -> Sensitivity:
    """Return the believed derivative of the voltage at every node by the power injected at every node.

    On a balanced feeder that of ``Scenario.model``. On a three-phase feeder that of its base load at the scenario's
    source voltage and capacitors: ``sensing.r_model_share`` of the one by active power, ``sensing.x_model_share`` of
    the one by reactive power. P.u. per MW and per Mvar, (n_node, n_node).
    """
    if isinstance(scenario.feeder, Feeder):
        return Sensitivity(*(_in_order(scenario, matrix, 0, 1) for matrix in sensitivity(scenario.model)))
    by_p, by_q = true_sensitivity(scenario)
    return Sensitivity(scenario.sensing.r_model_share * by_p, scenario.sensing.x_model_share * by_q)


@cached_on_owner
def true_sensitivity(scenario: Scenario) -> Sensitivity:
    """Return the derivative of :func:`believed_sensitivity` without the error of the model."""
    feeder = scenario.feeder
    if isinstance(feeder, Feeder):
        return sensitivity(feeder)
    control = Control(capacitor_on=scenario.capacitor_connected)
    return Sensitivity(
        *linearise(feeder, feeder.p_load_kw, feeder.q_load_kvar, scenario.source_voltage_pu, control)[:2]
    )


def _in_order(scenario: Scenario, values: np.ndarray, *axes: int) -> np.ndarray:
    """Return values of the model's buses along some axes in the order of the feeder's buses."""
    if scenario.model.bus_ids == scenario.feeder.bus_ids:
        return values
    for axis in axes:
        values = np.take(values, scenario.model_position, axis)
    return values


def sensitivity_to_agents(scenario: Scenario, buses: np.ndarray) -> Sensitivity:
    """Derivative of the voltage at every node by the power that each agent injects, in the believed feeder.

    Parameters
    ----------
    scenario
        Gives the feeder as it is believed, and what the agents are connected to.
    buses
        Position of each agent's bus in ``bus_ids``, (row, n_agent).

    Returns
    -------
    Sensitivity
        P.u. per MW and per Mvar, (row, n_agent, n_node).
    """
    if isinstance(scenario.feeder, Feeder):
        by_agent = _by_buses(scenario.model, scenario.model_position[buses])
        return Sensitivity(*(_in_order(scenario, rows, -1) for rows in by_agent))
    believed = believed_sensitivity(scenario)
    nodes = agent_nodes(scenario, buses)
    return Sensitivity(*(np.moveaxis(matrix[:, nodes].mean(-1), 0, -1) for matrix in believed))


def sensitivity_between_agents(scenario: Scenario, buses: np.ndarray) -> Sensitivity:
    """Return the derivative of each agent's voltage by the power that each agent injects, in the true feeder.

    ``buses`` is as in :func:`sensitivity_to_agents`; p.u. per MW and per Mvar, (row, n_agent, n_agent), the agent that
    sees first.
    """
    if _is_large(scenario.feeder):
        feeder = scenario.feeder
        by_agent = _by_buses(feeder, buses)
        return Sensitivity(*(np.moveaxis(_at_agents(by, buses), -1, -2) for by in by_agent))
    nodes = agent_nodes(scenario, buses)
    rows, columns = nodes[:, :, None, :, None], nodes[:, None, :, None, :]
    return Sensitivity(*(_pair_mean(rows, columns, matrix) for matrix in true_sensitivity(scenario)))


def agent_nodes(scenario: Scenario, buses: np.ndarray) -> np.ndarray:
    """Nodes of agents at positions ``buses`` (row, n_agent) of ``bus_ids``, int, (row, n_agent, k)."""
    return nodes_by_bus(scenario)[np.arange(scenario.n_agents), buses]


def _pair_mean(rows: np.ndarray, columns: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return matrix[rows, columns].mean((-1, -2))


DENSE_MOST = 2000
"""Nodes of the largest feeder whose matrices over all pairs of nodes are made; of others only rows, where they do."""
_ROWS_AT_ONCE = 64


def _is_large(feeder: AnyFeeder) -> bool:
    return isinstance(feeder, Feeder) and feeder.n_bus > DENSE_MOST


def _by_buses(feeder: Feeder, buses: np.ndarray) -> Sensitivity:
    """Derivative of every voltage by the power at the agents' buses (row, n_agent), (row, n_agent, n_bus)."""
    if not _is_large(feeder):
        r, x = sensitivity(feeder)
        if feeder.voltage_ratio is not None:  # without it the matrices are symmetric
            r, x = r.T, x.T
        return Sensitivity(r[buses], x[buses])
    once, position = np.unique(buses, return_inverse=True)
    return Sensitivity(*(rows[position.reshape(buses.shape)] for rows in sensitivity_by(feeder, once.tolist())))


def _at_agents(rows: np.ndarray, buses: np.ndarray) -> np.ndarray:
    """Entries (row, n_agent, n_agent) at the agents' buses of rows (row, n_agent, n_bus)."""
    columns = np.broadcast_to(buses[:, None, :], (*buses.shape, buses.shape[1]))
    return np.take_along_axis(rows, columns, axis=-1)


def between_agents(scenario: Scenario, buses: np.ndarray) -> np.ndarray:
    """Impedance magnitude of the path between any two agents at positions ``buses`` (row, n_agent) of ``bus_ids``.

    P.u. per MVA, (row, n_agent, n_agent), as :func:`between_buses` has it.
    """
    if not _is_large(scenario.feeder):
        return between_buses(scenario)[buses[:, :, None], buses[:, None, :]]
    feeder, buses = scenario.model, scenario.model_position[buses]
    ratio = 1.0 if feeder.voltage_ratio is None else feeder.voltage_ratio
    of_buses = [(values / ratio)[buses] for values in own_sensitivity(feeder)]
    by_agent = (_at_agents(rows / ratio, buses) for rows in _by_buses(feeder, buses))
    return np.hypot(*(o[:, :, None] + o[:, None, :] - 2.0 * by for o, by in zip(of_buses, by_agent, strict=True)))


@cached_on_owner
def between_buses(scenario: Scenario) -> np.ndarray:
    """Impedance magnitude of the path between any two buses, p.u. per MVA, (n_bus, n_bus).

    On a three-phase feeder that of the mean voltages under power that is shared equally among a bus's phases.
    """
    feeder, by_bus = scenario.feeder, believed_sensitivity(scenario)
    if not isinstance(feeder, Feeder):
        share = np.zeros((feeder.n_bus, feeder.n_node))
        share[feeder.node_bus, np.arange(feeder.n_node)] = 1.0 / np.bincount(feeder.node_bus)[feeder.node_bus]
        by_bus = [0.5 * share @ (matrix + matrix.T) @ share.T for matrix in by_bus]
    elif feeder.voltage_ratio is not None:
        by_bus = [matrix / feeder.voltage_ratio[:, None] for matrix in by_bus]
    return np.hypot(*(np.diag(m)[:, None] + np.diag(m)[None, :] - 2.0 * m for m in by_bus))


@cached_on_owner
def distance_in_bands(scenario: Scenario) -> np.ndarray:
    """(R_ii, X_ii) of each agent at each bus, in bands, (n_agent, n_bus, 2)."""
    return own_distance(scenario) / (scenario.cost.band_pu or 1.0)


def placement(scenario: Scenario, buses: np.ndarray) -> Placement:
    """What the agents' buses (positions, (row, n_agent)) mean for the observation."""
    feeder, distances = scenario.feeder, distance_in_bands(scenario)
    n_row, n_agent = buses.shape
    row = np.arange(n_row)[:, None, None]
    distances = distances[np.arange(n_agent), buses]
    local = agent_nodes(scenario, buses)
    nodes = legs = local + row * feeder.n_node
    if feeder.n_leg != feeder.n_node:
        legs = local + feeder.first_device_leg + row * feeder.n_leg
    count = min(N_NEIGHBOURS, n_agent - 1) if scenario.sensing.observe == "neighbours" else 0
    nearest = np.zeros((n_row, n_agent, 0), dtype=np.int64)
    if count:
        apart = between_agents(scenario, buses)
        apart[:, np.arange(n_agent), np.arange(n_agent)] = -1.0
        nearest = np.argsort(apart, axis=-1, kind="stable")[..., 1 : count + 1]
        nearest = nearest + np.arange(n_row)[:, None, None] * n_agent
    return Placement(distances[..., 0].copy(), distances[..., 1].copy(), nodes, legs, nearest)
