"""A batch of episodes that is driven by given actions, copied, and charged, whether an episode ends early or not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dcgrid_env import DcgridVectorEnv, Scenario


class Batch:
    """Episodes on their way.

    Parameters
    ----------
    env
        An environment that has been reset.
    cost
        Sum of the steps' costs so far, (lane,).
    over
        Whether the episode has ended, (lane,).
    """

    def __init__(self, env: DcgridVectorEnv, cost: np.ndarray, over: np.ndarray):
        self._env, self.cost, self._over = env, cost, over

    def step(self, actions: np.ndarray) -> Any:
        """Advance by joint actions, (lane, n_action); the state behind the step."""
        _, _, terminated, truncated, _ = self._env.step(actions)
        transition = self._env.transition
        self.cost = self.cost + transition.cost_j * ~self._over
        self._over = self._over | terminated | truncated
        return transition.state

    def fork(self, lanes: np.ndarray) -> Batch:
        """A batch whose episode i goes on from episode ``lanes[i]``."""
        return Batch(self._env.fork(lanes), self.cost[lanes], self._over[lanes])


def begun(scenario: Scenario, seeds: Sequence[int]) -> tuple[Batch, Any]:
    """A batch at the beginning of each seed's episode, and its state."""
    env = DcgridVectorEnv(len(seeds), scenario.replace(reward="shared"), info="none")
    env.reset(seed=list(seeds))
    return Batch(env, np.zeros(len(seeds)), np.zeros(len(seeds), bool)), env.transition.state


def driven(
    scenario: Scenario, seeds: Sequence[int], actions: np.ndarray, starts: Sequence[int] = (0,)
) -> tuple[np.ndarray, list[Any]]:
    """J of each episode under its actions, (step, episode, n_action), and the states that are passed at ``starts``."""
    batch, state = begun(scenario, seeds)
    states = [state]
    for step, action in enumerate(actions, start=1):
        state = batch.step(action)
        if step in starts:
            states.append(state)
    return batch.cost / scenario.horizon, states
