"""Which agents of a scenario stand where in joint observations and actions, by device and by kind of agent."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env import Scenario, action_layout, field_names

PLAIN_CHANNELS = {"datacenter": ("clock", "q"), "inverter": ("q",)}
"""Channels that the agents of a kind have if nothing else is said of them."""


class AgentGroup(NamedTuple):
    """The agents of one of a scenario's devices."""

    kind: str
    fields: tuple[str, ...]
    """What each of them observes."""
    channels: tuple[str, ...]
    """Names of the entries of each one's action."""
    agents: slice
    """Positions of the group among all agents."""
    seen: slice
    """Positions of their observations in the joint one, one agent after the other."""

    @property
    def n(self) -> int:
        """Number of agents."""
        return self.agents.stop - self.agents.start


def agent_groups(scenario: Scenario) -> dict[str, AgentGroup]:
    """The agents of a scenario by kind, in the order of its devices, without devices that nobody commands."""
    names, groups, first, first_field = field_names(scenario), {}, 0, 0
    for device in scenario.devices:
        if not device.count:
            continue
        fields, channels = names[scenario.agents[first]], tuple(channel.name for channel in device.channels)
        agents, seen = slice(first, first + device.count), slice(first_field, first_field + device.count * len(fields))
        groups[device.kind] = AgentGroup(device.kind, fields, channels, agents, seen)
        first, first_field = agents.stop, seen.stop
    return {kind: group for kind, group in groups.items() if group.channels}


def axes(scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Which entries of the joint action are clocks of data centres, and which reactive setpoints, bool, (n_action,)."""
    layout = action_layout(scenario)
    kinds = [device.kind for device in scenario.devices for _ in range(device.count)]
    of_site = {agent for agent, kind in zip(scenario.agents, kinds, strict=True) if kind == "datacenter"}
    by_site = np.array([agent in of_site for agent, _ in layout.names], dtype=bool)
    return layout.is_channel("clock") & by_site, layout.is_channel("q")
