"""Stable-Baselines3 vector environments on the native batch, implemented as array operations over the rows.

``JointVecEnv`` has a row for each environment, with the joint observation and action of ``gymnasium.make``.
``agent_vec_env`` has a row for each agent of each environment. Actions are set points, changes or corrections of the
droop, as in ``policy.interface``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from dcgrid_env import DcgridVectorEnv, Scenario, action_layout, end_costs
from dcgrid_env.agents.policy.interface import Gains, PolicyInterface
from dcgrid_env.agents.training.config import Act
from dcgrid_env.agents.training.row_form import Outputs, RowActions, RowForm, View, droop_gains
from dcgrid_env.baselines.equipment_agents import at_rest

REACH = {"setpoint": (1.0, 1.0, 1.0), "change": (2.0, 0.5, 0.25), "droop": (0.5, 0.5, 0.25)}
"""Network output for an action of 1: clock, reactive set point and other channel."""


class JointVecEnv(VecEnv):
    """One row for each environment of a native batch.

    Row i of a batch seeded with ``seed(n)`` begins with the episode of seed n + i. The last step of an
    episode has infos: ``infos[row]["terminal_observation"]`` is the last observation,
    ``infos[row]["TimeLimit.truncated"]`` is True at the horizon and False after a voltage collapse, and
    ``infos[row]["J"]`` is the cost. Other steps have empty infos. Rewards are the team's, or the
    difference rewards of the rows, less ``reward_mean``, times ``reward_scale``; ``physics_s`` is the time spent in
    steps. With ``end_as_it_arises`` each step pays for the change of the end charge that it causes, and the last step
    pays no more. The sum is the same.

    Parameters
    ----------
    scenario
        What to run; its reward must be the shared one or a difference. The droop as the default action of a difference
        reward has the gains of the droop that actions correct.
    n_envs
        Environments in the batch.
    act
        Channels that a policy drives: both, or the clock or the reactive power alone. The other is at the top clock or
        at zero reactive power.
    outputs
        Whether actions are setpoints, changes, or corrections of a droop.
    gains
        Gains of that droop; those of the tuned droop by default.
    render_mode
        None, "rgb_array" (an image of each environment) or "human" (a window shows the first environment).
    """

    kind = "joint"
    view: View = "joint"
    nameplate = False

    def __init__(
        self,
        scenario: Scenario,
        n_envs: int,
        act: Act = "both",
        outputs: Outputs = "setpoint",
        gains: Gains | None = None,
        render_mode: str | None = None,
    ):
        self.outputs: Outputs = outputs
        self.gains = (gains or droop_gains(scenario)) if outputs == "droop" else None
        if self.gains is not None and scenario.cost.default_action == "droop":
            scenario = scenario.replace(cost={"default_gains": tuple(self.gains)})
        self._interface = PolicyInterface(scenario, self.kind, act=act, outputs=outputs, gains=self.gains)
        self.batch = DcgridVectorEnv(n_envs, scenario, render_mode=render_mode, info="none")
        self.scenario, self.act, self.n_envs = self.batch.scenario, act, n_envs
        self.physics_s = 0.0
        self.reward_mean, self.reward_scale = 0.0, 1.0
        self.end_as_it_arises = False
        self._due = self._due_at_rest = np.zeros(n_envs)
        self._actions = self._observation = np.zeros(0)
        observation, action = self._spaces()
        super().__init__(n_envs * self.rows_per_env, observation, action)

    @property
    def rows_per_env(self) -> int:
        """Number of rows of an environment."""
        return 1

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

    @property
    def used(self) -> np.ndarray:
        """1 for each entry of an action that reaches the grid, else 0, float32, (1, n_action)."""
        return np.array([[in_hand(self.act, channel) for channel in self.channels]], np.float32)

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the entries of an action."""
        return tuple(channel for _, channel in action_layout(self.scenario).names)

    @cached_property
    def clocks(self) -> np.ndarray:
        """Which entries of an action are clocks, bool, (n_action,)."""
        return np.array([channel == "clock" for channel in self.channels])

    @property
    def further_channels(self) -> dict[str, tuple[str, ...]]:
        """Channels that a policy must list; see ``PolicyInterface.further_channels``."""
        return self._interface.further_channels

    @property
    def rest(self) -> np.ndarray:
        """Rest value of each action entry as a set point, float32, (n_action,)."""
        return at_rest(self.scenario).astype(np.float32)

    def _spaces(self) -> tuple[spaces.Box, spaces.Box]:
        observation, action = self.batch.single_observation_space, self.batch.single_action_space
        assert isinstance(observation, spaces.Box)
        assert isinstance(action, spaces.Box)
        return observation, self._action_space(action.shape[0])

    def _action_space(self, n_action: int) -> spaces.Box:
        form = RowForm(self.view, self.outputs, self.nameplate, self.gains, self.scenario.name)
        return RowActions(form, n_action)

    def _rows(self, joint: np.ndarray) -> np.ndarray:
        """Convert joint observations, (env, n_observation), to observations of the rows."""
        return joint

    def _means(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        """Outputs that ``view`` takes, from the rows' actions."""
        return {"joint": actions * self.reach}

    @cached_property
    def reach(self) -> np.ndarray:
        """Network output for an action of 1, float32, (n_action,)."""
        clock, q, other = REACH[self.outputs]
        return np.array([{"clock": clock, "q": q}.get(channel, other) for channel in self.channels], np.float32)

    def driven(self, joint: np.ndarray, predict: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """The joint action, (row, n), where ``predict`` gives the rows' actions for their observations.

        ``joint`` are joint observations, (row, n_observation), as many as one likes; nothing is stepped.
        """
        return self._interface.action(joint, self._means(predict(self._rows(joint))))

    def arrived(self) -> np.ndarray:
        """Return the observations after the last step, before any new episode, (row, n_observation)."""
        return self._rows(self.batch.transition.observation)

    @property
    def truncated(self) -> np.ndarray:
        """Whether the last step reached the horizon, bool, (row,)."""
        return np.repeat(self.batch.transition.truncated, self.rows_per_env)

    def reset(self) -> np.ndarray:
        """Begin episodes: those of the seed given by ``seed``, else each row's next one."""
        first = self._seeds[0]
        self._reset_seeds()
        self._observation, _ = self.batch.reset(seed=None if first is None else int(first))
        self._due = self._due_at_rest = self._end_costs()
        return self._rows(self._observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Observation, reward, done and infos of the rows."""
        began_s = time.perf_counter()
        joint = self._interface.action(self._observation, self._means(self._actions))
        self._observation, reward, terminated, truncated, _ = self.batch.step(joint)
        each = self.rows_per_env
        if each > 1 and self.scenario.cost.reward == "difference":
            reward = self._difference_rewards
        if self.end_as_it_arises:
            due = self._end_costs()
            reward = reward - (due - self._due) + due * truncated
            self._due = np.where(terminated | truncated, self._due_at_rest, due)  # every episode begins at rest
        done = np.repeat(terminated | truncated, each)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            last, ended, j = self.arrived(), self.truncated, np.repeat(self.batch.transition.j_so_far, each)
            for row in np.flatnonzero(done):
                infos[row]["terminal_observation"] = last[row].copy()
                infos[row]["TimeLimit.truncated"] = bool(ended[row])
                infos[row]["J"] = float(j[row])
        paid = (reward - self.reward_mean) * self.reward_scale
        paid = (paid.ravel() if paid.ndim == 2 else np.repeat(paid, each)).astype(np.float32)
        observation = self._rows(self._observation)
        self.physics_s += time.perf_counter() - began_s
        return observation, paid, done, infos

    @property
    def _difference_rewards(self) -> np.ndarray:
        """Difference rewards of the rows of the last step, (env, row of it)."""
        return self.batch.transition.reward

    def _end_costs(self) -> np.ndarray:
        """Return the end-of-episode cost after the last step, (env,)."""
        return sum(end_costs(self.scenario, self.batch.transition.state).values(), np.zeros(self.n_envs))

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


def in_hand(act: str, channel: str) -> bool:
    """Return whether a policy controls the channels of this name."""
    return act in ("both", channel)
