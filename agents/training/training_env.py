"""The rows of the native batch as a vector environment of Gymnasium, for any library that trains on one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from dcgrid_env import Scenario
from dcgrid_env.agents.training.row_batch import CLIP, RowBatch, Scaling, observation_scaling
from dcgrid_env.agents.training.row_form import Outputs, View
from dcgrid_env.agents.training.row_views import Rows, learning_rows


def training_env(
    scenario: str | Scenario,
    num_envs: int,
    view: View | None = None,
    *,
    outputs: Outputs | None = None,
    nameplate: bool | None = None,
    scale_observations: bool = True,
    action_repeat: int | None = None,
    autoreset_mode: Literal["same_step", "next_step"] = "same_step",
    render_mode: str | None = None,
    **overrides: object,
) -> RowVectorEnv:
    """Make a Gymnasium vector environment that steps ``num_envs`` environments as one native batch.

    It is for libraries other than Stable-Baselines3, and has the rows, actions and rewards of :func:`sb3_vec_env`,
    by default those with which training is fastest. A sub-environment is a row, such as a channel of an agent. With the
    reward "difference" use a discount of 0.

    Parameters
    ----------
    scenario
        Registered id, name of a preset, or a Scenario.
    num_envs
        Environments in the batch. The attribute ``num_envs`` of the result is the number of rows, as Gymnasium has it.
    view, outputs, nameplate, action_repeat
        What a row is and what its action means, see :func:`sb3_vec_env`.
    scale_observations
        Whether observations are scaled to mean 0 and standard deviation 1, by the numbers of :func:`ppo_settings`. They
        are in ``scaling.mean`` and ``scaling.std``, (n_observation,), and are the same for each split of a scenario.
        ``scaling(observations)`` applies them.
    autoreset_mode
        When the next episode begins: "same_step" or "next_step", see :class:`dcgrid_env.DcgridVectorEnv`. RLlib needs
        "next_step".
    render_mode
        None, "rgb_array" (an image of each environment) or "human" (a window shows the first environment).
    **overrides
        Any field of the Scenario, see :func:`sb3_vec_env`.

    Raises
    ------
    ScenarioError
        For an unknown scenario; TypeError for an override that is not a field of it.
    ValueError
        For an unknown or unsupported form, see :func:`sb3_vec_env`, or an unknown ``autoreset_mode``.

    Examples
    --------
    >>> from dcgrid_env.agents import training_env
    >>> envs = training_env("ieee33-weak", num_envs=2)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations.shape, envs.single_action_space.shape
    ((20, 15), (1,))
    """
    if autoreset_mode not in ("same_step", "next_step"):
        raise ValueError(f"autoreset_mode is {autoreset_mode!r}; choose same_step or next_step")
    rows = learning_rows(scenario, view, outputs, nameplate, action_repeat, overrides)
    scaling = observation_scaling(rows) if scale_observations else None
    return RowVectorEnv(rows, num_envs, scaling, autoreset_mode, render_mode)


class RowVectorEnv(gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """The rows of a native batch, environment by environment.

    Actions are clipped to [-1, 1]. In the step that ends an episode, ``infos`` has its last observations, "final_obs",
    and "final_info" with the cost "J", (num_envs,), and the mask "_J". With ``autoreset_mode`` "next_step" it has "J"
    and "_J" instead, and observations are the last ones. Other steps have empty infos.

    Parameters
    ----------
    rows
        What a row is, with the scenario.
    n_envs
        Environments in the batch.
    scaling
        Scaling of observations, or None.
    autoreset_mode, render_mode
        See :func:`training_env`.
    """

    def __init__(self, rows: Rows, n_envs: int, scaling: Scaling | None, autoreset_mode: str, render_mode: str | None):
        self.batch = RowBatch(rows, n_envs, render_mode=render_mode, autoreset_mode=autoreset_mode)
        self.rows, self.scenario, self.n_envs, self.scaling = rows, rows.scenario, n_envs, scaling
        self.num_envs, self.metadata, self.render_mode = n_envs * rows.per_env, self.batch.metadata, render_mode
        observed = rows.observation_space(self.batch.single_observation_space)
        if scaling is not None:
            observed = spaces.Box(-CLIP, CLIP, observed.shape)
        self.single_observation_space, self.single_action_space = observed, rows.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._joint = np.zeros(0)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes: in environment i that of ``seed + i``, or its next one without a seed.

        Seeds in a sequence and options are those of the batch's environments, not of the rows.
        """
        super().reset(seed=seed if isinstance(seed, int | np.integer) else None)
        self._joint, _ = self.batch.reset(seed=seed, options=options)
        return self._observed(self._joint), {}

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every environment by one step of the rows' actions, (num_envs, n_action).

        Raises
        ------
        ValueError
            If the actions have another shape, or an entry is not a finite number.
        """
        actions = np.asarray(actions, np.float32)
        if actions.shape != self.action_space.shape:
            raise ValueError(f"actions has the shape {actions.shape}; give {self.action_space.shape}")
        self._joint, rewards, *over, ends = self.batch.advance(self._joint, actions.clip(-1.0, 1.0))
        terminated, truncated = map(self._each, over)
        infos: dict[str, Any] = {}
        if (done := terminated | truncated).any():
            costs = {"J": np.where(done, self._each(self.batch.transition.j_so_far), 0.0), "_J": done}
            infos = costs
            if "final_obs" in ends:
                last = np.full(self.num_envs, None, dtype=object)
                for row, observed in enumerate(self._observed(self.batch.transition.observation)):
                    last[row] = observed if done[row] else None
                infos = {"final_obs": last, "_final_obs": done, "final_info": costs, "_final_info": done.copy()}
        return self._observed(self._joint), rewards.ravel(), terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Draw the environments of the batch, see :meth:`dcgrid_env.DcgridVectorEnv.render`."""
        return self.batch.render()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the batch."""
        self.batch.close()

    def _observed(self, joint: np.ndarray) -> np.ndarray:
        observed = self.rows.observed(joint)
        return observed if self.scaling is None else self.scaling(observed)

    def _each(self, of_envs: np.ndarray) -> np.ndarray:
        """Repeat a value of each environment for its rows."""
        return np.repeat(of_envs, self.rows.per_env)
