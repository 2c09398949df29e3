"""Linear model of the regulators' relays: how relay volts and voltages follow the agents' powers and the taps.

The slopes are differences of power flows around the feeder's base load and base taps. Only changes are predicted: each
step begins from the relay volts that are measured.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import ActingRelays, Control, Scenario, nodes_by_bus, solver_for

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
    share = share.reshape(-1, feeder.n_leg)
    none, step = 0.0 * share, np.eye(len(feeder.base_tap))[relays.rows]
    still = np.zeros((1 + len(step), feeder.n_leg))
    p_kw, q_kvar = (
        load + np.concatenate((still, *moved))
        for load, moved in ((feeder.p_load_kw, (share, none)), (feeder.q_load_kvar, (none, -share)))
    )
    taps = np.tile(feeder.base_tap, (len(p_kw), 1))
    taps[1 : 1 + len(step)] += step
    on = scenario.capacitor_connected
    on = None if on is None else np.broadcast_to(on, (len(p_kw), *np.shape(on)))
    solve = solver_for(feeder, scenario.power_flow)
    solution: Any = solve(feeder, p_kw, q_kvar, scenario.source_voltage_pu, Control(feeder.tap_ratio(taps), None, on))
    volts = relays.volts(solution)
    by_tap, by_p, by_q = np.split(volts[1:] - volts[0], [len(step), len(step) + len(share)])
    by_p, by_q = (by.reshape(n_row, n_agent, -1) / _SPAN for by in (by_p, by_q))
    v_pu = solution.v_pu[..., feeder.load_slice]
    sensing = scenario.sensing
    return RelayModel(
        relays, sensing.r_model_share * by_p, sensing.x_model_share * by_q, by_tap, v_pu[1 : 1 + len(step)] - v_pu[0]
    )
