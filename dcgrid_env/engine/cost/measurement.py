"""Voltages as they are measured: where, with what noise, and how late."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.engine.physics.node_figures import from_nodes, node_extremes
from dcgrid_env.engine.physics.state import State
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.scenario.scenario import Scenario


def measurement_noise(scenario: Scenario, key: np.ndarray, step: np.ndarray) -> np.ndarray | None:
    """Draw the noise of the measurements at ``step`` (row,), p.u., (row, n_measured); None without noise."""
    if scenario.sensing.noise_pu == 0.0:
        return None
    from dcgrid_env.core import random  # brings the compiler with it, so not on import

    n = scenario.feeder.n_node if scenario.sensing.observe == "feeder" else scenario.n_agents
    return scenario.sensing.noise_pu * random.standard(key, random.MEASUREMENT, step, n)


def measure(scenario: Scenario, state: State, noise: Array | None) -> Array:
    """Measure voltages, p.u., (row, n_measured): of every node where agents observe the feeder, else of the agents.

    On a three-phase feeder the agents' means are followed by their lowest and their highest phases, which one meter
    measures with one error.
    """
    true = state.v_pu if scenario.sensing.observe == "feeder" else state.v_agent_pu
    if state.three_phase is not None and scenario.sensing.observe != "feeder":
        xp, phases = namespace(true), state.three_phase
        true = xp.concat((true, phases.v_agent_lowest_pu, phases.v_agent_highest_pu), axis=-1)
        noise = None if noise is None else xp.concat((noise, noise, noise), axis=-1)
    return true if noise is None else true + noise


def of_agents(scenario: Scenario, measured_pu: Array, nodes: Array) -> tuple[Array, Array | None]:
    """The agents' voltages among what is measured, (row, n_agent), and of a three-phase feeder lowest, then highest.

    ``nodes`` are those of the agents, see ``Exogenous``; (row, 2 n_agent), None on a balanced feeder.
    """
    whole, n = scenario.sensing.observe == "feeder", scenario.n_agents
    if not isinstance(scenario.feeder, ThreePhaseFeeder):
        return from_nodes(measured_pu, nodes) if whole else measured_pu, None
    if not whole:
        return measured_pu[:, :n], measured_pu[:, n:]
    extremes = node_extremes(measured_pu, nodes)
    return from_nodes(measured_pu, nodes), namespace(measured_pu).concat(extremes, axis=-1)


def remembered(scenario: Scenario) -> int:
    """Number of measurements that are kept: the delayed one, the one before it, and those that are on their way."""
    return scenario.sensing.delay_steps + 2
