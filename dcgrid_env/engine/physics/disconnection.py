"""Devices that disconnect by themselves: their input, and their connected share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices.device import DeviceInput, may_leave
from dcgrid_env.devices.ride_through.connection import Supply
from dcgrid_env.engine.physics.state import Exogenous, State
from dcgrid_env.scenario.scenario import Scenario


@cached_on_owner
def disconnectable_devices(scenario: Scenario) -> tuple[int, ...]:
    """Positions of the groups of devices that may leave the grid."""
    return tuple(i for i, device in enumerate(scenario.devices) if may_leave(device))


def supply(scenario: Scenario, state: State, exogenous: Exogenous, agents: slice, device_input: DeviceInput) -> Supply:
    """Return the supply of the group with the agents ``agents``: voltages of lowest and highest phase, and sags.

    Before t = 0 the voltage is the source's.
    """
    if state.restart is None:
        low = high = 0.0 * state.p_kw[..., agents] + scenario.source_voltage_pu
    elif state.three_phase is None:
        low = high = state.v_agent_pu[..., agents]
    else:
        phases = state.three_phase
        low, high = phases.v_agent_lowest_pu[..., agents], phases.v_agent_highest_pu[..., agents]
    available = None if exogenous.available is None else exogenous.available[..., agents]
    return Supply(device_input, low, high, exogenous.sags, exogenous.trip_widths, available)


def connected_share(scenario: Scenario, states: Sequence[Any], like: Array, cuts: Sequence[slice]) -> Array:
    """Share of each agent's power that is on the grid, (row, n_agent), 1 for those that cannot leave."""
    one = 0.0 * like + 1.0
    with_ride_through = disconnectable_devices(scenario)
    parts = [
        scenario.devices[i].connected(states[i]) if i in with_ride_through else one[..., cut]  # pyright: ignore
        for i, cut in enumerate(cuts)
    ]
    return namespace(like).concat(parts, axis=-1)
