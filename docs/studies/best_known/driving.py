"""Drive batches of episodes by given actions, copy them and sum their costs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dcgrid_env import DcgridVectorEnv, Scenario


class Batch:
    """Episodes that have begun.

    Parameters
    ----------
    env
        An environment that has been reset.
    cost
        Sum of the steps' costs so far, (episode,).
    over
        Whether the episode has ended, (episode,).
    """

    def __init__(self, env: DcgridVectorEnv, cost: np.ndarray, over: np.ndarray):
        self._env, self.cost, self._over = env, cost, over

    def step(self, actions: np.ndarray) -> Any:
        """Advance by joint actions, (episode, n_action), and return the state after the step."""
        _, _, terminated, truncated, _ = self._env.step(actions)
        transition = self._env.transition
        self.cost = self.cost + transition.cost_j * ~self._over
        self._over = self._over | terminated | truncated
        return transition.state

    def fork(self, env_indices: np.ndarray) -> Batch:
        """Return a batch whose episode i continues from episode ``env_indices[i]``."""
        return Batch(self._env.fork(env_indices), self.cost[env_indices], self._over[env_indices])


def begun(scenario: Scenario, seeds: Sequence[int]) -> tuple[Batch, Any]:
    """Return a batch at the beginning of each seed's episode, and its state."""
    env = DcgridVectorEnv(len(seeds), scenario.replace(reward="shared"), info="none")
    env.reset(seed=list(seeds))
    return Batch(env, np.zeros(len(seeds)), np.zeros(len(seeds), bool)), env.transition.state


def driven(
    scenario: Scenario, seeds: Sequence[int], actions: np.ndarray, starts: Sequence[int] = (0,)
) -> tuple[np.ndarray, list[Any]]:
    """Return J of each episode under its actions, (step, episode, n_action), and the states at the steps ``starts``."""
    batch, state = begun(scenario, seeds)
    states = [state]
    for step, action in enumerate(actions, start=1):
        state = batch.step(action)
        if step in starts:
            states.append(state)
    return batch.cost / scenario.horizon, states
