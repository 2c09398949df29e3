"""Linear model of the regulators' relays: how relay volts and voltages follow the agents' powers and the taps.

The slopes are differences of power flows around the feeder's base load and base taps. Only changes are predicted: each
step begins from the relay volts that are measured.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import ActingRelays, Scenario, nodes_by_bus, relay_slopes

_SPAN = 10.0  # kW and kvar by which an agent's power is moved to find a slope


class RelayModel(NamedTuple):
    """Slopes of relay volts and of voltages, for R relays; one environment where all have the same placement."""

    relays: ActingRelays
    by_p: np.ndarray
    """Relay volts per kW drawn by each agent (negative), (row, n_agent, R)."""
    by_q: np.ndarray
    """Relay volts per kvar injected by each agent, (row, n_agent, R)."""
    by_tap: np.ndarray
    """Volts of the column relay per tap of the row regulator, (R, R)."""
    v_by_tap: np.ndarray
    """Voltage of each bus but the substation per tap, p.u., (R, n_load_node)."""


def relay_model(scenario: Scenario, relays: ActingRelays, buses: np.ndarray) -> RelayModel:
    """Return the model for agents at positions ``buses`` of ``bus_ids``, (row, n_agent)."""
    feeder: Any = scenario.feeder
    n_row, n_agent = buses.shape
    nodes = nodes_by_bus(scenario)[np.arange(n_agent), buses]
    share = np.zeros((n_row, n_agent, feeder.n_leg))
    row, agent = np.ogrid[:n_row, :n_agent]
    np.add.at(share, (row[..., None], agent[..., None], feeder.first_device_leg + nodes), _SPAN / nodes.shape[-1])
    slopes = relay_slopes(scenario, relays, share.reshape(-1, feeder.n_leg))
    by_p, by_q = (by.reshape(n_row, n_agent, -1) / _SPAN for by in (slopes.by_p, slopes.by_q))
    r_share, x_share = scenario.sensing.r_model_share, scenario.sensing.x_model_share
    return RelayModel(relays, r_share * by_p, x_share * by_q, slopes.by_tap, slopes.v_by_tap)
