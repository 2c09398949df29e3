"""Checks of the actions that come in through the interfaces. Values beyond [-1, 1] are cut by the physics."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.scenario.scenario import Scenario


class ActionError(ValueError):
    """An action of the wrong shape or kind, or not finite; the message names the agent."""


@cached_on_owner
def action_names(scenario: Scenario) -> tuple[tuple[str, str], ...]:
    """(agent, actuator) of each entry of the joint action."""
    return tuple(
        (agent, name) for agent in scenario.agents for name in (("clock", "q") if agent.startswith("dc_") else ("q",))
    )


def joint_action(scenario: Scenario, action: Any, lanes: int | None = None) -> np.ndarray:
    """The joint action as float64, (lane, n_action); one lane if ``lanes`` is None, given without that dimension."""
    n = len(action_names(scenario))
    want = (n,) if lanes is None else (lanes, n)
    try:
        array = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ActionError(f"the action is no array of numbers: {error}; give shape {want}") from None
    if array.shape != want:
        raise ActionError(f"the action has shape {array.shape}; it must be {want}: {_listing(scenario)}")
    array = array.reshape(-1, n)
    if not math.isfinite(array.sum()) and not np.isfinite(array).all():  # the sum alone is cheap, but may overflow
        lane, at = np.argwhere(~np.isfinite(array))[0]
        where = "" if lanes is None else f" in lane {lane}"
        agent, name = action_names(scenario)[at]
        raise ActionError(f"action of {agent}: {name} is {array[lane, at]}{where}; give a finite number in [-1, 1]")
    return array


def joined_actions(scenario: Scenario, actions: Any) -> np.ndarray:
    """One action an agent, a mapping, as a joint action of one lane."""
    try:
        parts = [actions[agent] for agent in scenario.agents]
    except (KeyError, TypeError, IndexError):
        given = list(actions) if hasattr(actions, "keys") else type(actions).__name__
        raise ActionError(f"actions must map each of {list(scenario.agents)} to its action; got {given}") from None
    if len(actions) != len(parts):
        extra = sorted(set(actions) - set(scenario.agents))
        raise ActionError(f"actions for unknown agents {extra}; the agents are {list(scenario.agents)}")
    n_dc = scenario.n_datacenters
    for i, (agent, part) in enumerate(zip(scenario.agents, parts, strict=True)):
        want = (2,) if i < n_dc else (1,)
        if np.shape(part) != want:
            raise ActionError(f"action of {agent} has shape {np.shape(part)}; it must be {want}")
    return joint_action(scenario, np.concatenate(parts))


def _listing(scenario: Scenario) -> str:
    return ", ".join(f"{agent} {name}" for agent, name in action_names(scenario))
