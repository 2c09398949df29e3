"""A Stable-Baselines3 vector environment on the native batch, implemented as array operations over the rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from dcgrid_env.agents.training.row_batch import RowBatch
from dcgrid_env.agents.training.row_views import Rows


class RowVecEnv(VecEnv):
    """The rows of a native batch, environment by environment.

    Environment i of a batch seeded with ``seed(n)`` begins with the episode of seed n + i. On the splits "validation"
    and "test", each further reset begins the same episodes, by default those of seed 0 on. ``EvalCallback`` therefore
    compares models on the same episodes. The last step of an
    episode has infos: ``infos[row]["terminal_observation"]`` is the last observation,
    ``infos[row]["TimeLimit.truncated"]`` is True at the horizon and False after a voltage collapse, and
    ``infos[row]["J"]`` is the cost. Other steps have empty infos. Rewards are those of
    ``Rows.paid``.

    Parameters
    ----------
    rows
        What a row is, with the scenario.
    n_envs
        Environments in the batch.
    render_mode
        None, "rgb_array" (an image of each environment) or "human" (a window shows the first environment).
    """

    def __init__(self, rows: Rows, n_envs: int, render_mode: str | None = None):
        self.batch = RowBatch(rows, n_envs, render_mode=render_mode)
        self.rows, self.scenario, self.n_envs = rows, rows.scenario, n_envs
        self._repeated = None if self.scenario.split == "train" else 0
        self._actions = self._observation = np.zeros(0)
        observations = rows.observation_space(self.batch.single_observation_space)
        super().__init__(n_envs * rows.per_env, observations, rows.action_space)

    @property
    def rows_per_env(self) -> int:
        """Number of rows of an environment."""
        return self.rows.per_env

    def n_eval_episodes(self, episodes: int) -> int:
        """Return ``n_eval_episodes`` with which Stable-Baselines3 evaluates a number of different episodes.

        ``evaluate_policy`` and ``EvalCallback`` count an episode once for each row that takes part in it.

        Raises
        ------
        ValueError
            If ``episodes`` is not a whole number of at least 1.
        """
        if isinstance(episodes, bool) or not isinstance(episodes, int | np.integer) or episodes < 1:
            raise ValueError(f"episodes is {episodes!r}; give a whole number of at least 1")
        return int(episodes) * self.rows_per_env

    def arrived(self) -> np.ndarray:
        """Return the observations after the last step, before any new episode, (row, n_observation)."""
        return self.rows.observed(self.batch.transition.observation)

    @property
    def truncated(self) -> np.ndarray:
        """Whether the last step reached the horizon, bool, (row,)."""
        return np.repeat(self.batch.transition.truncated, self.rows_per_env)

    def reset(self) -> np.ndarray:
        """Begin episodes: those of the seed given by ``seed``, else the next ones or, outside of training, the same."""
        first = self._repeated if self._seeds[0] is None else int(self._seeds[0])
        self._reset_seeds()
        self._repeated = None if self.scenario.split == "train" else first
        self._observation, _ = self.batch.reset(seed=first)
        return self.rows.observed(self._observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Observation, reward, done and infos of the rows."""
        self._observation, reward, terminated, truncated, _ = self.batch.advance(self._observation, self._actions)
        each = self.rows_per_env
        done = np.repeat(terminated | truncated, each)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            last, ended, j = self.arrived(), self.truncated, np.repeat(self.batch.transition.j_so_far, each)
            for row in np.flatnonzero(done):
                infos[row]["terminal_observation"] = last[row].copy()
                infos[row]["TimeLimit.truncated"] = bool(ended[row])
                infos[row]["J"] = float(j[row])
        return self.rows.observed(self._observation), reward.ravel().astype(np.float32), done, infos

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return an image (height, width, 3) of each environment; RuntimeError unless render mode is "rgb_array"."""
        if self.render_mode != "rgb_array":
            raise RuntimeError(f"render_mode is {self.render_mode!r}; make the rows with 'rgb_array' for images")
        return self.batch.render() or ()

    def render(self, mode: str | None = None) -> np.ndarray | None:
        """Tile the environments' images into one, or draw the first environment's window."""
        if self.render_mode == "human":
            self.batch.render()
            return None
        return super().render(mode)

    def close(self) -> None:
        """Close the batch."""
        self.batch.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the batch, once for each requested row."""
        return [getattr(self.batch, attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: object, indices: Any = None) -> None:
        """AttributeError: the rows are one batch."""
        raise AttributeError(f"{attr_name} cannot be set: the rows are one batch; make another with it")

    def env_method(self, method_name: str, *args: object, indices: Any = None, **kwargs: object) -> list[Any]:
        """AttributeError: the rows are one batch."""
        raise AttributeError(f"{method_name} cannot be called for a row alone; call it on .batch")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Never."""
        return [False] * self._count(indices)

    def _count(self, indices: int | Sequence[int] | None) -> int:
        return self.num_envs if indices is None else 1 if isinstance(indices, int) else len(indices)
