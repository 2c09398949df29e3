"""The voltage that the voltage cost is charged from: 1 p.u., or the utility's own voltage profile.

    deviation = |V - 1|                                   cost.reference = "nominal"
    deviation = max(|V - V*| - profile_band_pu, 0)        cost.reference = "profile", V* the target of each node

The target is ``cost.profile_pu`` if it is a number or names the node or its bus. Other nodes have the planned voltage:
the power flow of the nominal loads at the scenario's source voltage, without devices, with capacitors as in the
scenario. Regulators have settled at the settings in their table. Everything that charges or minimises the voltage cost
takes the targets from here. The violation is always charged around 1 p.u.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array, as_like, namespace
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.checked import refuse
from dcgrid_env.core.formula import formula, positive
from dcgrid_env.core.suggestions import nearest
from dcgrid_env.devices.ratings import read_only
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.grid.random_feeders.feeder_batch import FeederBatch
from dcgrid_env.powerflow import Control, solver_for
from dcgrid_env.scenario.errors import ScenarioError


def voltage_deviation(scenario: Any, v_pu: Array, nodes: slice = slice(None)) -> Array:
    """Deviation that the voltage cost is a function of, p.u., (..., node), of voltages at some of the nodes."""
    if scenario.cost.reference == "nominal":
        return namespace(v_pu).abs(v_pu - 1.0)
    return beyond_band(v_pu - _targets_like(scenario, v_pu)[..., nodes], scenario.cost.uncharged_pu)


def agents_deviation(scenario: Any, v_agent_pu: Array, v_pu: Array, nodes: Array | None) -> Array:
    """Deviation of each agent, p.u., (row, n_agent), whose voltage and target are the means over its nodes.

    ``nodes`` are as in ``Exogenous.nodes``, and ``v_pu`` (row, n_node) gives the shape that they are positions in.
    """
    if scenario.cost.reference == "nominal":
        return namespace(v_agent_pu).abs(v_agent_pu - 1.0)
    if nodes is None:
        raise ValueError(f"scenario {scenario.name!r} has a target for each node; give the nodes of the agents")
    targets = (0.0 * v_pu + _targets_like(scenario, v_pu)).reshape(-1)[nodes]
    return beyond_band(v_agent_pu - targets.sum(-1) / targets.shape[-1], scenario.cost.uncharged_pu)


@formula
def beyond_band(off_pu: Array, band_pu: float) -> Array:
    """What of a distance from a voltage lies beyond a band around it, p.u., of the distance ``off_pu``.

    The voltage cost has the target and ``Cost.uncharged_pu``, the violation 1 p.u. and ``Cost.band_pu``.
    """
    return positive(abs(off_pu) - band_pu)


@cached_on_owner
def voltage_targets(scenario: Any) -> np.ndarray:
    """Voltage of each node that the voltage cost is charged from, p.u., (n_node,).

    (row, n_node) for environments on several feeders.

    Raises
    ------
    ScenarioError
        If the targets are the utility's plan, and its power flow has no solution.
    """
    feeder, cost = scenario.feeder, scenario.cost
    if isinstance(feeder, FeederBatch):
        targets = np.empty((sum(len(rows) for _, rows in feeder.members), feeder.n_node))
        for member, rows in feeder.members:
            targets[rows] = _on_feeder(scenario, member)
    else:
        targets = _on_feeder(scenario, feeder)
    if isinstance(cost.profile_pu, tuple):
        for position, target in _named(feeder, cost.profile_pu):
            targets[..., position] = target
    return read_only(targets)


def _on_feeder(scenario: Any, feeder: Any) -> np.ndarray:
    """Targets of a feeder's nodes as far as ``profile_pu`` does not give them, p.u., (n_node,)."""
    cost, source_pu = scenario.cost, float(scenario.source_voltage_pu)
    if cost.reference == "nominal":
        return np.ones(feeder.n_node)
    if isinstance(cost.profile_pu, float):
        return np.full(feeder.n_node, cost.profile_pu)
    planned = _planned_pu(feeder, source_pu, scenario.power_flow, scenario.background.capacitors)
    if planned is None:
        raise ScenarioError(
            f"scenario {scenario.name!r}: cost.reference is 'profile', and the power flow of the nominal loads of "
            f"feeder {feeder.name!r} has no solution at a source voltage of {source_pu:g} p.u.; give cost.profile_pu"
        )
    return planned.copy()


@cached_on_owner
def _planned_pu(feeder: Any, source_pu: float, power_flow: str, has_capacitors: bool) -> np.ndarray | None:
    """Voltages of the nominal loads, p.u., (n_node,); None where the power flow has no solution."""
    p_kw, q_kvar, control = feeder.p_load_kw[None], feeder.q_load_kvar[None], None
    if isinstance(feeder, ThreePhaseFeeder):
        on = feeder.base_capacitor_on if has_capacitors else 0.0 * feeder.base_capacitor_on
        control = Control(None, None, on[None])
        tap = settled_taps(feeder, p_kw, q_kvar, source_pu, control).tap
        control = control._replace(tap_ratio=feeder.tap_ratio(tap))
    elif has_capacitors:
        q_kvar = q_kvar - feeder.capacitor_kvar
    solution = solver_for(feeder, power_flow)(feeder, p_kw, q_kvar, source_pu, control)
    return read_only(solution.v_pu[0]) if solution.converged[0] else None


def _targets_like(scenario: Any, like: Array) -> Array:
    """The targets as an array of the kind, precision and device of ``like``; made once for each."""
    if isinstance(like, np.ndarray) and like.dtype == np.float64:
        return voltage_targets(scenario)
    return _as_kind(scenario, namespace(like), like.dtype, like.device)


@cached_on_owner
def _as_kind(scenario: Any, xp: ModuleType, dtype: object, device: object) -> Array:
    return as_like(voltage_targets(scenario), xp.zeros(0, dtype=dtype, device=device))


def _named(feeder: Any, profile_pu: tuple[tuple[str, float], ...]) -> Iterator[tuple[Any, float]]:
    """Positions of nodes and their target, those of whole buses first: a node's own target counts."""
    given, buses = dict(profile_pu), {bus: i for i, bus in enumerate(feeder.bus_ids)}
    nodes = {node: i for i, node in enumerate(feeder.node_ids)}
    of_nodes = [name for name in given if name in nodes]
    yield from ((feeder.node_bus == buses[name], given[name]) for name in given if name not in nodes)
    yield from ((nodes[name], given[name]) for name in of_nodes)


def check_profile(scenario: Any) -> None:
    """Raise FieldError for a target of a bus or node that is not there, or whose voltage is not charged."""
    feeder, profile_pu = scenario.feeder, scenario.cost.profile_pu
    if not isinstance(profile_pu, tuple):
        return
    charged = {feeder.node_ids[i] for i in feeder.load_nodes} | set(feeder.bus_ids[1:])
    for name, _ in profile_pu:
        if name not in charged:
            listed = f"name buses of feeder {feeder.name!r} other than the substation's, or their nodes"
            raise refuse(scenario.cost, "profile_pu", f"{name!r} is not charged; {nearest(name, charged, listed)}")
