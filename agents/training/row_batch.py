"""The native batch as rows step it: agents can be paid alone, and an action can hold for several steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env import DcgridVectorEnv
from dcgrid_env.agents.training.row_views import Rows


class RowBatch(DcgridVectorEnv):
    """A native batch of environments for rows.

    Parameters
    ----------
    rows
        What a row is, with the scenario.
    n_envs
        Environments in the batch.
    settings
        Further arguments of :class:`dcgrid_env.DcgridVectorEnv`.
    """

    pays_team = False

    def __init__(self, rows: Rows, n_envs: int, **settings: Any):
        self.rows = rows
        super().__init__(n_envs, rows.scenario, info="none", **settings)

    def advance(
        self, joint: np.ndarray, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Apply actions of rows for ``rows.action_repeat`` steps, or until an episode ends.

        A step that begins episodes, with ``autoreset_mode`` "next_step", is one alone.

        Parameters
        ----------
        joint
            Joint observations before, (env, n).
        actions
            Actions of the rows, (env and row, n_action), at most 1 in size.

        Returns
        -------
        tuple
            Joint observations after, mean rewards of the rows, (env, row), terminated and truncated, (env,), and infos.
        """
        begins_episodes = self._simulation.now.over.any()
        paid: Any = 0.0
        steps = 0
        while True:
            joint, _, terminated, truncated, infos = self.step(self.rows.joint_action(joint, actions))
            paid, steps = paid + self.rows.paid(self.transition), steps + 1
            if steps == self.rows.action_repeat or begins_episodes or (terminated | truncated).any():
                return joint, paid / steps, terminated, truncated, infos
