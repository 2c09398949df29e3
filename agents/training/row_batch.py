"""The native batch as rows step it, and the means and standard deviations by which policies scale what rows observe."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import DcgridVectorEnv
from dcgrid_env.agents.training.row_views import Rows, make_rows

CLIP = 10.0
"""Largest absolute value of a scaled observation."""
ENVS, SEED = 8, 1 << 40
"""Environments of the episode by which observations are scaled, and the seed of the first."""
SMALLEST_SPREAD = 1e-2
"""Least standard deviation that an observation is divided by."""


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


class Scaling(NamedTuple):
    """Mean and standard deviation of each entry of a row's observation, float64, (n_observation,)."""

    mean: np.ndarray
    std: np.ndarray

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Return scaled observations in [-10, 10], float32, (..., n_observation)."""
        return ((observations - self.mean) / self.std).clip(-CLIP, CLIP).astype(np.float32)


def observation_scaling(rows: Rows) -> Scaling:
    """Return the scaling by a training episode of eight environments with small random actions.

    It is the same for each split of a scenario, so that a policy is tested with the scaling of its training.
    """
    rows = make_rows(rows.scenario.replace(split="train"), rows.form, action_repeat=rows.action_repeat)
    batch, rng = RowBatch(rows, ENVS), np.random.default_rng(0)
    joint, _ = batch.reset(seed=SEED)
    seen = [rows.observed(joint)]
    offset = 0.3 * rng.standard_normal((len(seen[0]), rows.n_action))
    for _ in range(rows.n_decisions):
        action = np.clip(offset + 0.3 * rng.standard_normal(offset.shape), -1.0, 1.0).astype(np.float32)
        joint, *_ = batch.advance(joint, action)
        seen.append(rows.observed(joint))
    figures = np.concatenate(seen).astype(np.float64)
    return Scaling(figures.mean(0), np.maximum(figures.std(0), SMALLEST_SPREAD))
