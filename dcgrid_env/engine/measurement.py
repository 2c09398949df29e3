"""Voltages as they are measured: where, with what noise, and how late."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.engine.state import State
from dcgrid_env.scenario.scenario import Scenario


def measurement_noise(scenario: Scenario, key: np.ndarray, step: np.ndarray) -> np.ndarray | None:
    """Draw the noise of the measurements at ``step`` (lane,), p.u., (lane, n_measured); None without noise."""
    if scenario.voltage_noise_pu == 0.0:
        return None
    from dcgrid_env.core import random  # brings the compiler with it, so not on import

    n = scenario.feeder.n_bus if scenario.observe == "feeder" else scenario.n_agents
    return scenario.voltage_noise_pu * random.standard(key, random.MEASUREMENT, step, n)


def measure(scenario: Scenario, state: State, noise: Array | None) -> Array:
    """Measure voltages, p.u., (lane, n_measured): of every bus where agents observe the feeder, else of the agents."""
    true = state.v_pu if scenario.observe == "feeder" else state.v_agent_pu
    return true if noise is None else true + noise


def remembered(scenario: Scenario) -> int:
    """Number of measurements that are kept: the delayed one, the one before it, and those that are on their way."""
    return scenario.measurement_delay + 2
