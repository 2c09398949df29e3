"""A Stable-Baselines3 vector environment of single channels, for one policy that drives every channel of every agent.

``ChannelVecEnv`` has a row for each entry of the joint action of each environment, environment by environment, such as
the clock and the reactive power of a data centre. A row observes what its agent observes in ``AgentVecEnv``, then a
figure for each channel, 1 for its own and 0 for the others. Its action is that entry alone. Likelihood and difference
reward therefore belong to one channel, without the noise of the others.
"""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from dcgrid_env import Scenario, action_layout
from dcgrid_env.agents.policy.interface import Gains
from dcgrid_env.agents.training.agent_vec_env import AgentVecEnv
from dcgrid_env.agents.training.batched_envs import Outputs


class ChannelVecEnv(AgentVecEnv):
    """One row for each channel of each agent, in the order of the joint action; see the module's head.

    Parameters
    ----------
    scenario, n_envs, outputs, gains, nameplate, render_mode
        Settings of the batch, see :class:`AgentVecEnv`.
    """

    view = "channel"

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
        self._column = np.array([self.channels.index(name) for name in self._of_names])
        """Channel of each row of an environment."""
        self._code = np.eye(len(self.channels), dtype=np.float32)[self._column]
        of_agent, _ = super()._spaces()
        zero = np.zeros(len(self.channels), np.float32)
        low, high = (np.concatenate(edges) for edges in ((of_agent.low, zero), (of_agent.high, zero + 1.0)))
        return spaces.Box(low, high, dtype=np.float32), self._action_space(1)

    def _rows(self, joint: np.ndarray) -> np.ndarray:
        code = np.broadcast_to(self._code, (len(joint), *self._code.shape))
        rows = np.concatenate((self._of_agents(joint)[:, self._owner], code), axis=-1)
        return rows.reshape(-1, rows.shape[-1])

    def _means(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        of_agents = np.zeros((self.n_envs, self.scenario.n_agents, len(self.channels)), np.float32)
        of_agents[:, self._owner, self._column] = actions.reshape(-1, len(self._owner))
        return super()._means(of_agents.reshape(-1, len(self.channels)))

    @property
    def _difference_rewards(self) -> np.ndarray:
        return self.batch.transition.reward_vector  # pyright: ignore[reportReturnType]
