"""Gymnasium environment: one agent holds all actuators."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from dcgrid_env.actions import joint_action
from dcgrid_env.face import Face, as_seed, check_running, joint_spaces
from dcgrid_env.info import info_arrays
from dcgrid_env.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.simulation import Transition


class DcgridEnv(Face, gymnasium.Env[np.ndarray, np.ndarray]):
    """A scenario as a single-agent environment; observation and action are the agents' joined, in their order.

    Parameters
    ----------
    scenario
        Name of a preset or a Scenario.
    render_mode
        None, "rgb_array" or "human".
    **overrides
        Any field of the Scenario, for instance ``horizon=60, split="test"``.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012 (gymnasium declares it so)

    def __init__(self, scenario: str | Scenario = "ieee123", *, render_mode: str | None = None, **overrides: Any):
        self._setup(scenario, 1, render_mode, overrides, joint=True)
        self.observation_space, self.action_space = joint_spaces(self.scenario)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin a seed's first episode, or the next one if no seed is given."""
        seed = as_seed(seed)
        super().reset(seed=seed)
        transition = self._reset([seed], self.np_random)
        return transition.observation[0].copy(), self._info(transition)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance one step; RuntimeError once the episode is over."""
        check_running(self)
        transition = self._step(joint_action(self.scenario, action))
        return (
            transition.observation[0].copy(),
            float(transition.reward[0]),
            bool(transition.terminated[0]),
            bool(transition.truncated[0]),
            self._info(transition),
        )

    def _info(self, transition: Transition) -> dict[str, Any]:
        return {name: values.item() for name, values in info_arrays(transition).items()} | self._bus_of
