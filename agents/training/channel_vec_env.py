"""A Stable-Baselines3 vector environment of single channels, for one policy that drives every channel of every agent.

``ChannelVecEnv`` has a row for each entry of the joint action of each environment, environment by environment, such as
the clock and the reactive power of a data centre. A row observes what its agent observes in ``AgentVecEnv``, then a
figure for each channel, 1 for its own and 0 for the others. Its action is that entry alone. Likelihood and difference
reward therefore belong to one channel, without the noise of the others.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from gymnasium import spaces

from dcgrid_env import Scenario, action_layout
from dcgrid_env.agents.policy.interface import Gains
from dcgrid_env.agents.training.agent_vec_env import AgentVecEnv
from dcgrid_env.agents.training.batched_envs import Outputs
from dcgrid_env.agents.training.row_form import View


class ChannelVecEnv(AgentVecEnv):
    """One row for each channel of each agent, in the order of the joint action; see the module's head.

    Parameters
    ----------
    scenario, n_envs, outputs, gains, nameplate, render_mode
        Settings of the batch, see :class:`AgentVecEnv`.
    """

    view: View = "channel"

    def __init__(
        self,
        scenario: Scenario,
        n_envs: int,
        outputs: Outputs = "setpoint",
        gains: Gains | None = None,
        nameplate: bool = False,
        render_mode: str | None = None,
    ):
        names, agents = action_layout(scenario).names, {agent: i for i, agent in enumerate(scenario.agents)}
        self._owner = np.array([agents[agent] for agent, _ in names])
        self._of_names = [name for _, name in names]
        super().__init__(scenario, n_envs, "both", outputs, gains, nameplate, render_mode)

    @property
    def rows_per_env(self) -> int:
        """Rows of an environment."""
        return len(self._owner)

    def _spaces(self) -> tuple[spaces.Box, spaces.Box]:
        observation, _ = super()._spaces()
        return observation, self._action_space(1)

    @cached_property
    def _column(self) -> np.ndarray:
        """Channel of each row of an environment, (row,)."""
        return np.array([self.channels.index(name) for name in self._of_names])

    @cached_property
    def _sources(self) -> np.ndarray:
        code = np.eye(len(self.channels), dtype=np.int64)[self._column]
        return np.concatenate((super()._sources[self._owner], self._zero + code), axis=1)

    def _means(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        of_agents = np.zeros((self.n_envs, self.scenario.n_agents, len(self.channels)), np.float32)
        of_agents[:, self._owner, self._column] = actions.reshape(-1, len(self._owner))
        return super()._means(of_agents.reshape(-1, len(self.channels)))

    @property
    def _difference_rewards(self) -> np.ndarray:
        return self.batch.transition.reward_vector  # pyright: ignore[reportReturnType]
