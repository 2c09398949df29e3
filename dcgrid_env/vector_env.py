"""Gymnasium vector environment: a native batch, all lanes stepped by the same array operations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from dcgrid_env.actions import joint_action
from dcgrid_env.face import Face, as_seed, joint_spaces
from dcgrid_env.info import info_arrays
from dcgrid_env.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.simulation import Transition


class DcgridVectorEnv(Face, gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """``num_envs`` lanes of a scenario; lane i seeded with seed + i is the single environment's episode of that seed.

    A lane whose episode ends begins its next one in the same step: the observation returned is the new episode's first,
    the old one's last stands in ``infos["final_obs"]`` and its info in ``infos["final_info"]``.

    Parameters
    ----------
    num_envs
        Lanes.
    scenario, render_mode, **overrides
        As for :class:`dcgrid_env.DcgridEnv`; what is drawn is lane 0.
    """

    metadata = {  # noqa: RUF012 (gymnasium declares it so)
        "render_modes": ["human", "rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Scenario = "ieee123",
        *,
        render_mode: str | None = None,
        **overrides: Any,
    ):
        if not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise ValueError(f"num_envs is {num_envs!r}; give a whole number of at least 1")
        self._setup(scenario, int(num_envs), render_mode, overrides, joint=True)
        self.num_envs = int(num_envs)
        self.single_observation_space, self.single_action_space = joint_spaces(self.scenario)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._everyone = np.ones(self.num_envs, dtype=bool)
        self._bus_keys = [f"bus_{agent}" for agent in self.scenario.agents]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes: lane i with ``seed + i`` (or ``seed[i]``), or each lane's next one if no seed is given.

        ``options={"reset_mask": mask}`` resets only the lanes where the bool array ``mask`` is True.
        """
        if seed is None or isinstance(seed, int | np.integer):
            first = as_seed(seed)
            seeds = [None if first is None else first + i for i in range(self.num_envs)]
        else:
            seeds, first = [as_seed(s) for s in seed], None
            if len(seeds) != self.num_envs:
                raise ValueError(f"{len(seeds)} seeds for num_envs = {self.num_envs}; give one for each, or one int")
        mask = (options or {}).get("reset_mask")
        if mask is not None:
            if np.shape(mask) != (self.num_envs,) or np.asarray(mask).dtype != np.bool_:
                raise ValueError(f"reset_mask must be a bool array of shape ({self.num_envs},)")
            if not self._simulation.begun:
                raise ValueError("the first reset must be of all lanes; leave reset_mask out")
        super().reset(seed=first)
        transition = self._reset(seeds, self.np_random, mask)
        return transition.observation.copy(), self._infos(transition, self._everyone if mask is None else mask)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every lane by one step of joint actions (num_envs, n_action)."""
        transition = self._step(joint_action(self.scenario, actions, self.num_envs))
        self._last = None
        done = transition.terminated | transition.truncated
        if not done.any():
            begun, infos = transition, self._infos(transition, self._everyone)
        else:
            final_info = self._infos(transition, done)
            final_obs = np.full(self.num_envs, None, dtype=object)
            for i in np.flatnonzero(done):
                final_obs[i] = transition.observation[i].copy()
            begun = self._reset([None] * self.num_envs, self.np_random, done)
            self._last = transition
            infos = self._infos(begun, self._everyone)
            infos |= {"final_obs": final_obs, "_final_obs": done, "final_info": final_info, "_final_info": done}
        return (
            begun.observation.copy(),
            transition.reward.copy(),
            transition.terminated.copy(),
            transition.truncated.copy(),
            infos,
        )

    def _infos(self, transition: Transition, valid: np.ndarray) -> dict[str, Any]:
        """Arrays over lanes, each beside its mask of valid lanes, as gymnasium's vector environments give them."""
        figures = {name: values.copy() for name, values in info_arrays(transition).items()}
        infos: dict[str, Any] = figures | dict(zip(self._bus_keys, self._bus_names.T.copy(), strict=True))
        return infos | {f"_{name}": valid.copy() for name in infos}
