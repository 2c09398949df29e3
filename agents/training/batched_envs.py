"""Stable-Baselines3 vector environments made directly on the native batch; all is array operations over its lanes.

``JointVecEnv`` has a lane for each environment: the joint observation and action, as ``gymnasium.make`` has them.
``AgentVecEnv`` has a lane for each agent of each environment, environment by environment, for one policy that drives
them all; its observation holds, in this order,

    the fields of either kind of agent, each once by name, 0 where an agent has no such field
    with nameplate: those that ``policy.interface`` adds
    kind: 1 for a data centre, 0 for an inverter

and its action is (clock, q), of which an inverter's clock goes nowhere. The reward is the team's, for each lane alike.
Actions are setpoints, changes or corrections of the droop, as ``policy.interface`` has them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from dcgrid_env import DcgridVectorEnv, Scenario, action_layout, field_names, under_own_control
from dcgrid_env.agents.policy.interface import Gains, PolicyInterface
from dcgrid_env.agents.training.config import Act
from dcgrid_env.baselines import make_controller

Outputs = Literal["setpoint", "change", "droop"]
REACH = {"setpoint": (1.0, 1.0), "change": (2.0, 0.5), "droop": (0.5, 0.5)}
"""What an action of 1 is, of a clock and of a reactive setpoint, as an output of a network."""
LARGEST = {"setpoint": 1.0, "change": 5.0, "droop": 5.0}
"""Largest action; changes are meant to stay well within it."""
KINDS = ("datacenter", "inverter")


def droop_gains(scenario: Scenario) -> Gains:
    """Those of the tuned droop law; ValueError where none ship."""
    law: Any = make_controller("droop-tuned", scenario)
    return Gains(law.k_p_mw_per_pu, law.k_q_mvar_per_pu_s, law.alpha_per_s)


class JointVecEnv(VecEnv):
    """One lane for each environment of a native batch.

    Lane i of a batch seeded with ``seed(n)`` begins with the episode of seed n + i. An episode's last observation
    stands in ``infos[lane]["terminal_observation"]``, ``infos[lane]["TimeLimit.truncated"]`` says whether it ended at
    the horizon rather than in a voltage collapse, and ``infos[lane]["J"]`` is its cost; other steps have empty infos.
    Rewards are the team's less ``reward_mean``, times ``reward_scale``; ``physics_s`` is the time spent in steps.

    Parameters
    ----------
    scenario
        What to run; its reward must be the shared one.
    n_envs
        Environments in the batch.
    act
        What a policy has in hand: both, or the clock or the reactive power alone, the other being held at the top clock
        or at no reactive power.
    outputs
        Whether actions are setpoints, changes, or corrections of the tuned droop.
    render_mode
        None, "rgb_array" (an image of each environment) or "human" (a window shows the first environment).
    """

    kind = "joint"

    def __init__(
        self,
        scenario: Scenario,
        n_envs: int,
        act: Act = "both",
        outputs: Outputs = "setpoint",
        render_mode: str | None = None,
    ):
        self.outputs: Outputs = outputs
        self.gains = droop_gains(scenario) if outputs == "droop" else None
        self._interface = PolicyInterface(scenario, self.kind, act=act, outputs=outputs, gains=self.gains)
        self.batch = DcgridVectorEnv(n_envs, scenario, render_mode=render_mode, info="none")
        self.scenario, self.act, self.n_envs = self.batch.scenario, act, n_envs
        self.physics_s = 0.0
        self.reward_mean, self.reward_scale = 0.0, 1.0
        self._actions = self._observation = np.zeros(0)
        observation, action = self._spaces()
        super().__init__(n_envs * self.lanes_per_env, observation, action)

    @property
    def lanes_per_env(self) -> int:
        """Lanes of an environment."""
        return 1

    @property
    def used(self) -> np.ndarray:
        """1 for each entry of an action that reaches the grid, else 0, float32, (1, n_action)."""
        return np.where(self.clocks, self.act != "q", self.act != "clock").astype(np.float32)[None]

    @property
    def clocks(self) -> np.ndarray:
        """Which entries of an action are clocks, bool, (n_action,)."""
        return action_layout(self.scenario).is_channel("clock")

    def _spaces(self) -> tuple[spaces.Box, spaces.Box]:
        observation, action = self.batch.single_observation_space, self.batch.single_action_space
        assert isinstance(observation, spaces.Box)
        assert isinstance(action, spaces.Box)
        return observation, self._action_space(action.shape[0])

    def _action_space(self, n_action: int) -> spaces.Box:
        largest = LARGEST[self.outputs]
        self._n_action = n_action
        return spaces.Box(-largest, largest, (n_action,), np.float32)

    def _rows(self, joint: np.ndarray) -> np.ndarray:
        """Observations of the lanes, from joint ones (env, n_observation)."""
        return joint

    def _means(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        """Outputs that ``view`` takes, from the lanes' actions."""
        return {"joint": actions * self.reach}

    @property
    def reach(self) -> np.ndarray:
        """What an action of 1 is as an output, float32, (n_action,)."""
        return np.where(self.clocks, *REACH[self.outputs]).astype(np.float32)

    def arrived(self) -> np.ndarray:
        """What the last step led to, before any new episode began: (lane, n_observation)."""
        return self._rows(self.batch.transition.observation)

    @property
    def truncated(self) -> np.ndarray:
        """Whether the last step was the horizon's, bool, (lane,)."""
        return np.repeat(self.batch.transition.truncated, self.lanes_per_env)

    def reset(self) -> np.ndarray:
        """Begin episodes: those of the seed given by ``seed``, else each lane's next one."""
        first = self._seeds[0]
        self._reset_seeds()
        self._observation, _ = self.batch.reset(seed=None if first is None else int(first))
        return self._rows(self._observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Observation, reward, done and infos of the lanes."""
        began_s = time.perf_counter()
        joint = self._interface.action(self._observation, self._means(self._actions))
        self._observation, reward, terminated, truncated, _ = self.batch.step(joint)
        each = self.lanes_per_env
        done = np.repeat(terminated | truncated, each)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done.any():
            last, ended, j = self.arrived(), self.truncated, np.repeat(self.batch.transition.j_so_far, each)
            for lane in np.flatnonzero(done):
                infos[lane]["terminal_observation"] = last[lane].copy()
                infos[lane]["TimeLimit.truncated"] = bool(ended[lane])
                infos[lane]["J"] = float(j[lane])
        paid = np.repeat((reward - self.reward_mean) * self.reward_scale, each).astype(np.float32)
        observation = self._rows(self._observation)
        self.physics_s += time.perf_counter() - began_s
        return observation, paid, done, infos

    def get_images(self) -> Sequence[np.ndarray | None]:
        """An image (height, width, 3) of each environment; RuntimeError unless the render mode is "rgb_array"."""
        if self.render_mode != "rgb_array":
            raise RuntimeError(f"render_mode is {self.render_mode!r}; make the lanes with 'rgb_array' for images")
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
        """An attribute of the batch, once for each lane asked for."""
        return [getattr(self.batch, attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """AttributeError: the lanes are one batch."""
        raise AttributeError(f"{attr_name} cannot be set: the lanes are one batch; make another with it")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """AttributeError: the lanes are one batch."""
        raise AttributeError(f"{method_name} cannot be called for a lane alone; call it on .batch")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Never."""
        return [False] * self._count(indices)

    def _count(self, indices: int | Sequence[int] | None) -> int:
        return self.num_envs if indices is None else 1 if isinstance(indices, int) else len(indices)


class AgentVecEnv(JointVecEnv):
    """One lane for each agent of each environment, (environment, agent) in turn; see the module's head.

    Parameters
    ----------
    scenario, n_envs, act, outputs, render_mode
        Settings of the batch, see :class:`JointVecEnv`.
    nameplate
        Whether the nameplate figures are observed.
    """

    kind = "shared"

    def __init__(
        self,
        scenario: Scenario,
        n_envs: int,
        act: Act = "both",
        outputs: Outputs = "setpoint",
        nameplate: bool = False,
        render_mode: str | None = None,
    ):
        if under_own_control(scenario) is not scenario:
            raise ValueError(
                f"view is 'shared'; {scenario.name!r} has regulators or capacitor banks among its agents, which share "
                "no policy with the others: choose 'joint', or give under_own_control(scenario)"
            )
        names = field_names(scenario)
        agents = scenario.agents
        self.fields = tuple(dict.fromkeys(name for agent in (agents[0], agents[-1]) for name in names[agent]))
        self._agent_interface = PolicyInterface(scenario, "shared", nameplate=nameplate)
        kind = KINDS[0] if scenario.n_datacenters else KINDS[1]
        self._figures = self._agent_interface.widths[kind][0] - len(names[agents[0]])
        self._kind = (np.arange(len(agents)) < scenario.n_datacenters).astype(np.float32)
        super().__init__(scenario, n_envs, act, outputs, render_mode)

    @property
    def lanes_per_env(self) -> int:
        """Lanes of an environment."""
        return self.scenario.n_agents

    @property
    def used(self) -> np.ndarray:
        """1 for each entry of an action that reaches the grid, else 0, float32, (2, 2): an inverter, a data centre."""
        clock, q = self.act != "q", self.act != "clock"
        return np.array([[0, q], [clock, q]], np.float32)

    @property
    def clocks(self) -> np.ndarray:
        """Which entries of an action are clocks, bool, (n_action,)."""
        return np.array([True, False])

    def columns(self, agent: str) -> np.ndarray:
        """Where a lane's observation holds the agent's own observation, and its nameplate figures if there are any."""
        own = [self.fields.index(name) for name in field_names(self.scenario)[agent]]
        return np.array(own + [len(self.fields) + i for i in range(self._figures)])

    def _spaces(self) -> tuple[spaces.Box, spaces.Box]:
        joint, _ = super()._spaces()
        low, high = (self._rows(edge[None]).reshape(len(self._kind), -1) for edge in (joint.low, joint.high))
        low, high = low.min(axis=0), high.max(axis=0)
        plate = slice(len(self.fields), len(self.fields) + self._figures)
        low[plate], high[plate] = -np.inf, np.inf
        low[-1], high[-1] = 0.0, 1.0
        return spaces.Box(low, high, dtype=np.float32), self._action_space(2)

    def _rows(self, joint: np.ndarray) -> np.ndarray:
        lanes = np.zeros((len(joint), len(self._kind), len(self.fields) + self._figures + 1), np.float32)
        lanes[..., -1] = self._kind
        agents, n_dc = self.scenario.agents, self.scenario.n_datacenters
        inputs = self._agent_interface.inputs(joint)
        for kind, members in zip(KINDS, (slice(0, n_dc), slice(n_dc, None)), strict=True):
            if kind in inputs:
                lanes[:, members, self.columns(agents[members][0])] = inputs[kind]
        return lanes.reshape(-1, lanes.shape[-1])

    def _means(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        n_dc = self.scenario.n_datacenters
        each = (actions * self.reach).reshape(self.n_envs, -1, 2)
        return {"datacenter": each[:, :n_dc], "inverter": each[:, n_dc:, 1:]}
