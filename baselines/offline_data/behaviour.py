"""What acts in the episodes of a data set: a controller, maybe with noise, random actions, or plans made beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dcgrid_env import Scenario, action_layout
from dcgrid_env.baselines.controller import Controller, NeedsPlacement
from dcgrid_env.baselines.rollout import action_of

_STREAM = 0x0FF11E
"""Keeps the draws of a behaviour apart from any other use of the same seeds."""


def drawn(seed: int, behaviour_seed: int) -> np.random.Generator:
    """Random numbers for the behaviour in the episode of a seed, independent of other episodes."""
    return np.random.default_rng((_STREAM, behaviour_seed, seed))


class RandomActions:
    """Actions drawn evenly from [-1, 1], each entry at each step by itself.

    Parameters
    ----------
    seeds
        Seeds of the episodes, one environment each.
    behaviour_seed
        Another one gives other actions in the same episodes.
    """

    def __init__(self, seeds: Sequence[int], behaviour_seed: int):
        self._generators = [drawn(seed, behaviour_seed) for seed in seeds]

    def reset(self, env_info: Scenario) -> None:
        """Begin the episodes of a scenario."""
        self._n_action = action_layout(env_info).n

    def act(self, observations: Any) -> np.ndarray:
        """Joint actions, (row, n_action), float32."""
        return np.stack([rng.uniform(-1.0, 1.0, self._n_action) for rng in self._generators]).astype(np.float32)


class Planned:
    """Actions that were planned for the whole of each episode, played whatever is observed.

    Parameters
    ----------
    plans
        (row, T, n_action) in [-1, 1].
    """

    def __init__(self, plans: np.ndarray):
        self._plans = plans

    def reset(self, env_info: Scenario) -> None:
        """Begin the episodes."""
        self._step = 0

    def act(self, observations: Any) -> np.ndarray:
        """Joint actions of the step at hand, (row, n_action)."""
        self._step += 1
        return self._plans[:, self._step - 1]


class Behaviour:
    """A controller whose actions are kept as the environment is given them: float32, within [-1, 1], noise included.

    Parameters
    ----------
    controller
        What acts.
    seeds
        Seeds of the episodes, one environment each.
    noise
        Standard deviation of normal noise on each entry of an action, which reaches from -1 to 1.
    behaviour_seed
        Another one gives other noise in the same episodes.
    """

    def __init__(self, controller: Controller, seeds: Sequence[int], noise: float, behaviour_seed: int):
        self._controller, self._noise = controller, noise
        self._generators = [drawn(seed, behaviour_seed) for seed in seeds]
        self.actions: list[np.ndarray] = []
        """Actions of each step since ``reset``, (row, n_action), float32."""

    def reset(self, env_info: Scenario) -> None:
        """Begin episodes."""
        self.actions = []
        self._controller.reset(env_info)

    def place(self, buses: np.ndarray) -> None:
        """Take positions in ``bus_ids`` of the agents' buses, (row, n_agent), and hand them on if they are needed."""
        self.buses = buses
        if isinstance(self._controller, NeedsPlacement):
            self._controller.place(buses)

    def act(self, observations: Any) -> np.ndarray:
        """Joint actions, (row, n_action), float32, within [-1, 1]."""
        action = np.asarray(action_of(self._controller, observations), dtype=np.float64)
        if self._noise:
            action = action + self._noise * np.stack(
                [rng.standard_normal(action.shape[-1]) for rng in self._generators]
            )
        self.actions.append(np.clip(action, -1.0, 1.0).astype(np.float32))
        return self.actions[-1]
