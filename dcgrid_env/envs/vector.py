"""Gymnasium vector environment: a native batch, all environments stepped by the same array operations."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from dcgrid_env.core.checked import shown
from dcgrid_env.core.seeds import MOST_ENVS, as_seed
from dcgrid_env.engine.physics.actions import joint_action
from dcgrid_env.envs.base import BaseEnvironment, joint_reward, joint_spaces
from dcgrid_env.envs.class_docs import documented
from dcgrid_env.envs.episode_options import episode_options
from dcgrid_env.envs.info import InfoLevel, drop_step_keys, info_arrays, step_keys
from dcgrid_env.envs.plain_spec import PlainSpec
from dcgrid_env.envs.time_limit import with_horizon
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition

AUTORESET_MODES = {mode.name.lower(): mode for mode in AutoresetMode}
"""Gymnasium's modes by the names that ``autoreset_mode`` takes."""


@documented
class DcgridVectorEnv(  # pyright: ignore[reportIncompatibleVariableOverride]
    PlainSpec, BaseEnvironment, gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]
):
    """Voltage control of distribution feeders as a Gymnasium vector environment: a batch that is stepped together.

    {training}

    Problem
    -------
    {problem}

    The batch has ``num_envs`` environments of one scenario. Environment i with seed n + i has the same episode as
    ``DcgridEnv`` with that seed.

    Action space
    ------------
    ``Box(-1, 1, (num_envs, n_action), float32)``: the actions of all devices, one after the other, dc_0 first.

    {actions}

    Observation space
    -----------------
    ``Box(low, high, (num_envs, n_observation), float32)``: the observations of all devices, in the same order.

    {observations}

    Reward
    ------
    {reward}

    Starting state
    --------------
    {start}

    Episode end
    -----------
    {end}

    An environment whose episode has ended begins the next one as ``autoreset_mode`` selects, in the way of
    ``SyncVectorEnv``:

    - "same_step" (default): in the same step. The observation is the first of the new episode. The last observation of
      the old one is in ``infos["final_obs"]``, its info in ``infos["final_info"]``. No step is lost.
      Stable-Baselines3 and TorchRL need this mode.
    - "next_step": in the next step, which ignores the action and has reward 0. This is the default of Gymnasium's
      vector environments. Gymnasium's vector observation wrappers and RLlib need this mode.
    - "disabled": only by ``reset(options={"reset_mask": mask})``. ``step`` raises RuntimeError before it.

    Information
    -----------
    ``infos`` has an array (num_envs,) for each key, and the bus of each agent under the key "bus_AGENT", such as
    "bus_dc_0". The array under "_KEY" is True for the environments that have the key. An environment that begins an
    episode has no figures of a step: its entries are NaN, and False under "_KEY". With "same_step", those of the last
    step are in ``infos["final_info"]``.

    {info}

    Parameters
    ----------
    num_envs
        Number of environments.
    scenario
        Name of a scenario, or a Scenario.
    render_mode
        None, "rgb_array" (``render`` returns a tuple of images, one for each environment) or "human" (a window shows
        environment 0).
    info
        Contents of ``infos``: "full", "costs" or "none".
    autoreset_mode
        "same_step", "next_step" or "disabled", or Gymnasium's AutoresetMode.
    max_episode_steps
        Steps in an episode (default: the horizon of the scenario); -1 means the default too.
    **overrides
        Fields of the scenario to override, for instance ``horizon=60, split="test"``.

    Examples
    --------
    >>> import gymnasium, dcgrid_env
    >>> envs = gymnasium.make_vec("dcgrid/IEEE33-v0", num_envs=64)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())
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
        info: InfoLevel = "full",
        autoreset_mode: str | AutoresetMode = "same_step",
        max_episode_steps: int | None = None,
        **overrides: object,
    ):
        whole = isinstance(num_envs, int | np.integer) and not isinstance(num_envs, bool)
        if not whole or not 1 <= num_envs <= MOST_ENVS:
            remedy = f"give a whole number of at least 1 and at most {MOST_ENVS:,}"
            raise ValueError(f"num_envs is {shown(num_envs)}; {remedy}")
        self.autoreset_mode = as_autoreset_mode(autoreset_mode)
        self.metadata = type(self).metadata | {"autoreset_mode": self.autoreset_mode}
        overrides = with_horizon(overrides, "max_episode_steps", max_episode_steps)
        self._setup(scenario, int(num_envs), render_mode, info, overrides, joint=True)
        self.num_envs = int(num_envs)
        self.single_observation_space, self.single_action_space = joint_spaces(self.scenario)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._everyone = np.ones(self.num_envs, dtype=bool)
        self._bus_keys = [f"bus_{agent}" for agent in self.scenario.agents]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin episodes: environment i with ``seed + i`` (or ``seed[i]``), or each one's next if no seed is given.

        ``options={"reset_mask": mask}`` resets only the environments where the bool array ``mask`` is True.
        ``options={"buses": .., "begin_h": ..}``, either or both, sets what a reset of all would draw:
        positions in ``feeder.bus_ids`` of the agents' buses, (num_envs, n_agents), and the time of day at which each
        environment begins, h, (num_envs,). With load profiles, it counts from the midnight before their first sample.
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
            if not np.any(mask):
                raise ValueError("reset_mask is False for every environment; leave the reset out")
            if not self._simulation.has_begun:
                raise ValueError("the first reset must be of all environments; leave reset_mask out")
        drawn = episode_options(self.scenario, self.num_envs, options or {})
        if drawn is not None and mask is not None:
            raise ValueError(
                "reset_mask is combined with buses or begin_h, which are of all environments; give one or the other"
            )
        super().reset(seed=first)
        transition = self._reset(seeds, self.np_random, mask, drawn)
        infos = self._infos(transition, self._everyone if mask is None else np.asarray(mask))
        drop_step_keys(self.scenario, infos)
        return transition.observation.copy(), infos

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every environment by one step of joint actions (num_envs, n_action); ended ones by the mode."""
        over = self._simulation.now.over
        if not over.any():
            transition = self._step(joint_action(self.scenario, actions, self.num_envs))
        elif self.autoreset_mode is AutoresetMode.NEXT_STEP:
            heeded = np.where(over[:, None], 0.0, actions) if np.ndim(actions) == 2 else actions
            transition = self._simulation.step_or_begin(joint_action(self.scenario, heeded, self.num_envs))
            self._arrived()
        else:
            raise RuntimeError(
                f"the episodes of environments {np.flatnonzero(over).tolist()} are over; "
                "reset them with options={'reset_mask': mask}"
            )
        self._last = None
        done = transition.terminated | transition.truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP and done.any():
            initial, infos = self._begin_anew(transition, done)
        else:
            initial, infos = transition, self._infos(transition, self._everyone)
        return (
            initial.observation.copy(),
            joint_reward(transition),
            transition.terminated.copy(),
            transition.truncated.copy(),
            infos,
        )

    def fork(self, env_indices: Sequence[int] | np.ndarray) -> DcgridVectorEnv:
        """Return a new environment whose episode i continues from the current state of episode ``env_indices[i]``.

        An episode may be copied many times, for instance to try several actions from the same state.

        Parameters
        ----------
        env_indices
            Positions in this batch, each in 0 .. num_envs - 1.

        Raises
        ------
        ValueError
            For a position that does not exist, or none.
        ScenarioError
            For a scenario on random feeders.
        """
        from dcgrid_env.engine.snapshot import taken  # brings the compiler with it, so not on import

        chosen = np.asarray(env_indices)
        if (
            chosen.ndim != 1
            or not chosen.size
            or chosen.dtype.kind not in "iu"
            or chosen.min() < 0
            or chosen.max() >= self.num_envs
        ):
            raise ValueError(
                f"env_indices is {env_indices!r}; give positions in 0 .. {self.num_envs - 1}, at least one"
            )
        if isinstance(self.scenario.feeder, RandomFeeders):
            raise ScenarioError("fork: episodes on random feeders cannot be copied; choose one feeder")
        env = DcgridVectorEnv(len(chosen), self.scenario, info=self.info_level, autoreset_mode=self.autoreset_mode)
        env._simulation.go_on(taken(self.save(), chosen, self.scenario))
        env._arrived()
        return env

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Draw the environments: a tuple of images (height, width, 3) uint8; for "human" a window of the first."""
        viewer = self._drawable()
        if self.render_mode == "human":
            return viewer.draw()
        return tuple(viewer.draw(env_index) for env_index in range(self.num_envs))

    def _on_spec(self) -> None:
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            _warn_about_statistics(gymnasium.__version__)

    def _begin_anew(self, transition: Transition, done: np.ndarray) -> tuple[Transition, dict[str, Any]]:
        """Return the first transition of the next episode where one is over, and infos with the last one."""
        final_info = self._infos(transition, done)
        final_obs = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(done):
            final_obs[i] = transition.observation[i].copy()
        initial = self._reset([None] * self.num_envs, self.np_random, done)
        self._last = transition
        infos = self._infos(initial, self._everyone)
        infos |= {"final_obs": final_obs, "_final_obs": done, "final_info": final_info, "_final_info": done.copy()}
        return initial, infos

    def _infos(self, transition: Transition, valid: np.ndarray) -> dict[str, Any]:
        """Return arrays over environments, each with its mask of valid entries, in gymnasium's format.

        An environment whose episode has just begun has no figures of a step: NaN, and False in the mask.
        """
        figures = info_arrays(self.scenario, transition, self.info_level)
        # Rows of one array are made several times faster than arrays one by one, and share nothing either.
        infos: dict[str, Any] = dict(zip(figures, np.array(list(figures.values())), strict=True))
        if transition.reward_vector is not None and self.info_level != "none":
            infos["reward_vector"] = transition.reward_vector.copy()
        if self.info_level == "full":
            infos |= zip(self._bus_keys, self._bus_names.T.copy(), strict=True)
        masks = np.repeat(valid[None], len(infos), axis=0)
        infos |= zip(_mask_keys(tuple(infos)), masks, strict=True)
        at_reset = self._simulation.now.step == 0
        if at_reset.any():
            for key in step_keys(self.scenario, tuple(infos)):
                infos[key][at_reset] = np.nan
                infos[f"_{key}"][at_reset] = False
        return infos


@cache
def _warn_about_statistics(version: str) -> None:
    """Warn, once, if Gymnasium's statistics of episodes that begin in the same step are wrong in this version."""
    if tuple(int(part) for part in version.split(".")[:2]) < (1, 4):
        warnings.warn(
            f"in gymnasium {version}, the vector wrapper RecordEpisodeStatistics leaves out the first step of episodes "
            "that begin in the same step; install gymnasium 1.4 or newer, or pass autoreset_mode='next_step'",
            stacklevel=5,
        )


@cache
def _mask_keys(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"_{name}" for name in names)


def as_autoreset_mode(mode: object) -> AutoresetMode:
    """Return Gymnasium's mode for a mode or its name; ValueError otherwise."""
    if isinstance(mode, AutoresetMode):
        return mode
    chosen = AUTORESET_MODES.get(mode) if isinstance(mode, str) else None
    if chosen is None:
        raise ValueError(f"autoreset_mode is {mode!r}; choose one of {', '.join(AUTORESET_MODES)}")
    return chosen
