"""Record the input range of a policy's networks on its training scenario, for storage on its card."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import RandomFeeders, Scenario
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import NeedsPlacement, rollout

EPISODES = 64
"""Episodes of the training split over which a range is recorded, on each scenario."""
SMALLEST_SPAN = 1e-2
"""Smallest width of a range for the computation of distances; constant inputs have zero width."""
OF_PLACE = ("r", "x", "draw", "reach")
"""Inputs that describe location and size of an agent and are constant within an episode."""


class InputRange(NamedTuple):
    """Range of each input of a network."""

    fields: tuple[str, ...]
    """Names of its inputs, see ``PolicyInterface.input_fields``."""
    low: tuple[float, ...]
    """Minimum of each input."""
    high: tuple[float, ...]
    """Maximum of each input."""

    def beyond(self, inputs: np.ndarray) -> np.ndarray:
        """Return the distance of each input outside its range, in widths of the range, (..., n_in); 0 inside."""
        low, high = np.array(self.low), np.array(self.high)
        width = np.maximum(high - low, SMALLEST_SPAN)
        return np.maximum(np.maximum(low - inputs, inputs - high) / width, 0.0)

    @property
    def of_place(self) -> np.ndarray:
        """Inputs that describe location and size of the agent, bool, (n_in,)."""
        return np.array([field.rpartition(".")[2] in OF_PLACE for field in self.fields])


def with_plates(policy: Any) -> PolicyInterface:
    """Return the network inputs on the scenario of the last ``reset``, always with the nameplate inputs.

    A policy that does not see its ratings is no less made for those that it was trained with.
    """
    interface = policy.interface
    return PolicyInterface(interface.scenario, policy.kind, preview=policy.preview, nameplate=True)


class _Recorded:
    """Control with a policy and record the minimum and maximum of each network input."""

    def __init__(self, policy: Any):
        self.policy, self.observe = policy, policy.observe
        self.ends: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def reset(self, env_info: Scenario) -> None:
        self._equipment = self.policy.equipment_agents(env_info)
        self.policy.reset(self._equipment.others)
        self.interface = with_plates(self.policy)

    def act(self, observations: Any) -> Any:
        return self._equipment.act(observations, self._act)

    def _act(self, joint: np.ndarray) -> np.ndarray:
        for name, inputs in self.interface.inputs(joint).items():
            rows = inputs.reshape(-1, inputs.shape[-1]).astype(np.float64)
            low, high = self.ends.get(name, (np.inf, -np.inf))
            self.ends[name] = np.minimum(low, rows.min(0)), np.maximum(high, rows.max(0))
        return self.policy.act(joint)


def recorded(policy: Any, scenarios: Sequence[Scenario], episodes: int = EPISODES) -> dict[str, InputRange] | None:
    """Return the range of each network's inputs, with the nameplate inputs, on the training split.

    None for a policy that is given a model of the feeder: its inputs are figures of a law, the same on any feeder.
    Raises ValueError without a scenario.

    Parameters
    ----------
    policy
        A :class:`Policy`.
    scenarios
        What it was trained on, whatever their split.
    episodes
        Seeds 0, 1, .. of each; of random feeders one on each of so many.
    """
    if isinstance(policy, NeedsPlacement):
        return None
    if not scenarios:
        raise ValueError("the policy names no scenario that it was trained on")
    driver = _Recorded(policy)
    for scenario in scenarios:
        feeder = scenario.feeder
        step = feeder.batch if isinstance(feeder, RandomFeeders) else 1
        with on_purpose():  # variants of a scenario are what it was trained on, but not what it names
            rollout(scenario.replace(split="train"), driver, range(0, episodes * step, step))
    fields = driver.interface.input_fields
    return {
        name: InputRange(fields[name], tuple(low.tolist()), tuple(high.tolist()))
        for name, (low, high) in driver.ends.items()
    }
