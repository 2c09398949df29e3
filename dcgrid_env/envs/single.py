"""Gymnasium environment: one agent controls all actuators."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from dcgrid_env.core.seeds import as_seed
from dcgrid_env.engine.physics.actions import joint_action
from dcgrid_env.envs.base import BaseEnvironment, check_running, joint_reward, joint_spaces
from dcgrid_env.envs.class_docs import documented
from dcgrid_env.envs.info import InfoLevel, drop_step_keys, info_arrays
from dcgrid_env.envs.plain_spec import PlainSpec
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Transition


@documented
class DcgridEnv(PlainSpec, BaseEnvironment, gymnasium.Env[np.ndarray, np.ndarray]):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Voltage control of a distribution feeder as a Gymnasium environment, whose agent controls every device.

    {training}

    Problem
    -------
    {problem}

    Action space
    ------------
    ``Box(-1, 1, (n_action,), float32)``: the actions of all devices, one after the other, dc_0 first.

    {actions}

    Observation space
    -----------------
    ``Box(low, high, (n_observation,), float32)``: the observations of all devices, in the same order.

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

    ``horizon`` sets the number of steps, and so does ``max_episode_steps`` in ``gymnasium.make`` of a registered id. A
    shorter ``TimeLimit`` that is put around the environment by hand ends episodes without charging leftover work; the
    third reset in a row at the same step warns of it.

    Information
    -----------
    ``info`` has NumPy scalars, and the bus of each agent under the key "bus_AGENT", such as "bus_dc_0". That of a reset
    does not have the keys that belong to a step.

    {info}

    Parameters
    ----------
    scenario
        Name of a scenario, or a Scenario.
    render_mode
        None, "rgb_array" or "human".
    info
        Contents of ``info``: "full", "costs" or "none".
    **overrides
        Fields of the scenario to override, for instance ``horizon=60, split="test"``.

    Examples
    --------
    >>> import gymnasium, dcgrid_env
    >>> env = gymnasium.make("dcgrid/IEEE33-v0", horizon=60)
    >>> observation, info = env.reset(seed=0)
    >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012 (gymnasium declares it so)

    def __init__(
        self,
        scenario: str | Scenario = "ieee123",
        *,
        render_mode: str | None = None,
        info: InfoLevel = "full",
        **overrides: object,
    ):
        self._setup(scenario, 1, render_mode, info, overrides, joint=True)
        self._bus_keys = [f"bus_{agent}" for agent in self.scenario.agents]
        self.observation_space, self.action_space = joint_spaces(self.scenario)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin a seed's first episode, or the next one if no seed is given."""
        seed = as_seed(seed)
        super().reset(seed=seed)
        transition = self._reset([seed], self.np_random)
        info = self._info(transition)
        drop_step_keys(self.scenario, info)
        return transition.observation[0].copy(), info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance one step; RuntimeError once the episode is over."""
        check_running(self)
        transition = self._step(joint_action(self.scenario, action))
        return (
            transition.observation[0].copy(),
            float(joint_reward(transition)[0]),
            bool(transition.terminated[0]),
            bool(transition.truncated[0]),
            self._info(transition),
        )

    def _info(self, transition: Transition) -> dict[str, Any]:
        figures = {name: values[0] for name, values in info_arrays(self.scenario, transition, self.info_level).items()}
        if transition.reward_vector is not None and self.info_level != "none":
            figures["reward_vector"] = transition.reward_vector[0].copy()
        if self.info_level == "full":
            figures.update(self._bus_of)
        return figures

    def _arrived(self) -> None:
        super()._arrived()
        self._bus_of = dict(zip(self._bus_keys, self._bus_names[0], strict=True))
