"""The joint action: positions of the channels of each agent, and checks of actions.

Values beyond [-1, 1] are cut by the physics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices import Q
from dcgrid_env.scenario.scenario import Scenario


class ActionError(ValueError):
    """An action of the wrong shape or kind, or not finite; the message names the agent."""


class ActionLayout:
    """Position of each channel of each agent in the joint action; made once for a scenario.

    Agents follow one another, each with the channels of its device in their order.
    """

    def __init__(self, scenario: Scenario):
        self.names: tuple[tuple[str, str], ...]
        """(agent, channel) of each entry."""
        names, self._cuts, reactive = [], [0], []
        self.columns: list[tuple[slice, ...]] = []
        """For each device the entries of its channels but the reactive one, a slice each."""
        agents = iter(scenario.agents)
        for device in scenario.devices:
            first, width = len(names), len(device.channels)
            for _ in range(device.count):
                agent = next(agents)
                names += [(agent, channel.name) for channel in device.channels]
                self._cuts.append(len(names))
            columns = [slice(first + i, len(names), width) for i in range(width)]
            called = [channel.name for channel in device.channels]
            self.columns.append(tuple(c for c, name in zip(columns, called, strict=True) if name != Q))
            reactive += [first + called.index(Q) + i * width if Q in called else -1 for i in range(device.count)]
        self.names = tuple(names)
        self.n = len(names)
        """Number of entries."""
        self.bounds = np.full(self.n, -1.0, np.float32), np.full(self.n, 1.0, np.float32)
        """Lowest and highest value of each entry."""
        self.reactive = np.array(reactive, dtype=np.int64)
        """Entry of each agent's reactive channel, -1 for an agent without one, (n_agent,)."""
        self.agents = scenario.agents
        self.widths = dict(zip(self.agents, np.diff(self._cuts).tolist(), strict=True))
        """Number of channels of each agent."""
        self.slices = {agent: slice(a, b) for agent, a, b in zip(self.agents, self._cuts, self._cuts[1:], strict=False)}
        """Position of each agent's action in the joint action."""

    def is_channel(self, name: str) -> np.ndarray:
        """Whether an entry is of the channel of this name, bool, (n_action,)."""
        return np.array([channel == name for _, channel in self.names], dtype=bool)

    def joint(self, **channels: np.ndarray) -> np.ndarray:
        """The joint action of the entries of each channel, by its name, (..., n) over the agents that have it."""
        like = next(iter(channels.values()))
        joint = np.zeros((*like.shape[:-1], self.n), like.dtype)
        for name, entries in channels.items():
            joint[..., self.is_channel(name)] = entries
        return joint

    def split(self, joint: Array) -> dict[str, Any]:
        """Each agent's action, views of the joint one, (..., n) each."""
        return {agent: joint[..., cut] for agent, cut in self.slices.items()}

    def join(self, actions: Mapping[str, Any]) -> np.ndarray:
        """The joint action of a mapping from agent to its action, each (..., n)."""
        return np.concatenate([actions[agent] for agent in self.agents], axis=-1)


@cached_on_owner
def action_layout(scenario: Scenario) -> ActionLayout:
    """The layout of a scenario's joint action."""
    return ActionLayout(scenario)


def joint_action(scenario: Scenario, action: object, num_envs: int | None = None) -> np.ndarray:
    """The joint action as float64, (row, n_action); ``num_envs`` None is one environment without that dimension."""
    layout = action_layout(scenario)
    n = layout.n
    want = (n,) if num_envs is None else (num_envs, n)
    try:
        array = np.asarray(action)
    except (TypeError, ValueError) as error:
        raise ActionError(f"the action is no array of numbers: {error}; give shape {want}") from None
    if array.dtype.kind not in "fiub":
        raise ActionError(f"the action is no array of numbers but of {array.dtype}; give real numbers in shape {want}")
    array = array.astype(np.float64, copy=False)
    if array.shape != want:
        listing = ", ".join(f"{agent} {name}" for agent, name in layout.names)
        raise ActionError(f"the action has shape {array.shape}; it must be {want}: {listing}")
    array = array.reshape(-1, n)
    if not math.isfinite(array.sum()) and not np.isfinite(array).all():  # the sum alone is cheap, but may overflow
        env_index, column = np.argwhere(~np.isfinite(array))[0]
        where = "" if num_envs is None else f" in environment {env_index}"
        agent, name = layout.names[column]
        raise ActionError(
            f"action of {agent}: {name} is {array[env_index, column]}{where}; give a finite number in [-1, 1]"
        )
    return array


def joined_actions(scenario: Scenario, actions: Any) -> np.ndarray:
    """One action an agent, a mapping, as a joint action of one environment."""
    layout = action_layout(scenario)
    try:
        parts = [actions[agent] for agent in layout.agents]
    except (KeyError, TypeError, IndexError):
        received = list(actions) if hasattr(actions, "keys") else type(actions).__name__
        raise ActionError(f"actions must map each of {list(layout.agents)} to its action; got {received}") from None
    if len(actions) != len(parts):
        extra = sorted(set(actions) - set(layout.agents))
        raise ActionError(f"actions for unknown agents {extra}; the agents are {list(layout.agents)}")
    for (agent, width), part in zip(layout.widths.items(), parts, strict=True):
        if (part.shape if type(part) is np.ndarray else np.shape(part)) != (width,):
            raise ActionError(f"action of {agent} has shape {np.shape(part)}; it must be {(width,)}")
    return joint_action(scenario, np.concatenate(parts))
