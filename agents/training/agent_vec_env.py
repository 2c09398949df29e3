"""A Stable-Baselines3 vector environment of single agents, for one policy that drives agents of every kind.

``AgentVecEnv`` has a row for each agent of each environment, environment by environment, for one policy that drives
them all; its observation holds, in this order,

    the fields of every kind of agent, each once by name, 0 where an agent has no such field
    with nameplate: those that ``policy.interface`` adds
    kind: 1 for a data centre, 0 for another; then a figure for each kind but inverters, 1 for an agent of it

and its action is (clock, q) and then the other channels of its agents, each once by name; entries that an agent does
not have, as an inverter's clock, go nowhere. The reward is the team's, for each row alike.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from gymnasium import spaces

from dcgrid_env import Scenario, action_layout, field_names, under_own_control
from dcgrid_env.agents.policy.agent_groups import PLAIN_CHANNELS
from dcgrid_env.agents.policy.interface import Gains, PolicyInterface
from dcgrid_env.agents.training.batched_envs import JointVecEnv, Outputs, in_hand
from dcgrid_env.agents.training.config import Act
from dcgrid_env.agents.training.row_form import View
from dcgrid_env.baselines.equipment_agents import at_rest


class AgentVecEnv(JointVecEnv):
    """One row for each agent of each environment, (environment, agent) in turn; see the module's head.

    Parameters
    ----------
    scenario, n_envs, act, outputs, gains, render_mode
        Settings of the batch, see :class:`JointVecEnv`.
    nameplate
        Whether the nameplate figures are observed.
    """

    kind = "shared"
    view: View = "shared"

    def __init__(
        self,
        scenario: Scenario,
        n_envs: int,
        act: Act = "both",
        outputs: Outputs = "setpoint",
        gains: Gains | None = None,
        nameplate: bool = False,
        render_mode: str | None = None,
    ):
        if under_own_control(scenario, keep_set_points=True) is not scenario:
            raise ValueError(
                f"view is {self.view!r}; {scenario.name!r} has regulators or capacitor banks among its agents, which "
                "share no policy with the others: choose 'joint', or give under_own_control(scenario, "
                "keep_set_points=True)"
            )
        view = self._agent_interface = PolicyInterface(scenario, "shared", nameplate=nameplate)
        self.fields = tuple(dict.fromkeys(name for group in view.groups.values() for name in group.fields))
        self.nameplate, self._figures = nameplate, 3 * nameplate
        self.kinds = ("inverter", "datacenter", *(kind for kind in view.groups if kind not in PLAIN_CHANNELS))
        """Kinds of agents in the order of the rows of ``used``; all but the first have a figure in the observation."""
        self.members = {kind: np.arange(group.agents.start, group.agents.stop) for kind, group in view.groups.items()}
        """Positions of the agents of each kind among all."""
        self._kind = np.zeros((scenario.n_agents, len(self.kinds) - 1), np.float32)
        for i, kind in enumerate(self.kinds[1:]):
            self._kind[self.members.get(kind, []), i] = 1.0
        super().__init__(scenario, n_envs, act, outputs, gains, render_mode)

    @property
    def rows_per_env(self) -> int:
        """Rows of an environment."""
        return self.scenario.n_agents

    @property
    def used(self) -> np.ndarray:
        """1 for each entry of an action that reaches the grid, else 0, float32, (kind, n_action), see ``kinds``."""
        channels_of = PLAIN_CHANNELS | self._agent_interface.channels
        return np.array(
            [[name in channels_of[kind] and in_hand(self.act, name) for name in self.channels] for kind in self.kinds],
            np.float32,
        )

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the entries of an action."""
        of_kinds = self._agent_interface.channels.values()
        return tuple(dict.fromkeys(("clock", "q", *(name for names in of_kinds for name in names))))

    @property
    def rest(self) -> np.ndarray:
        """Inactive action as a set point: the mean over the agents that have the channel, float32, (n_action,)."""
        resting, layout = at_rest(self.scenario), action_layout(self.scenario)
        at_rest_values = [resting[layout.is_channel(name)] for name in self.channels]
        return np.array([values.mean() if len(values) else 0.0 for values in at_rest_values], np.float32)

    def entries(self, kind: str) -> list[int]:
        """Where a row's action holds the channels of agents of a kind, in their order."""
        return [self.channels.index(name) for name in self._agent_interface.channels[kind]]

    def columns(self, agent: str) -> np.ndarray:
        """Where a row's observation holds the agent's own observation, and its nameplate figures if there are any."""
        field_columns = [self.fields.index(name) for name in field_names(self.scenario)[agent]]
        return np.array(field_columns + [len(self.fields) + i for i in range(self._figures)])

    def _spaces(self) -> tuple[spaces.Box, spaces.Box]:
        joint, _ = super()._spaces()
        low, high = (self._rows(edge[None]).reshape(self.rows_per_env, -1) for edge in (joint.low, joint.high))
        low, high = low.min(axis=0), high.max(axis=0)
        plate = slice(len(self.fields), len(self.fields) + self._figures)
        low[plate], high[plate] = -np.inf, np.inf
        low[plate.stop :], high[plate.stop :] = 0.0, 1.0
        return spaces.Box(low, high, dtype=np.float32), self._action_space(len(self.channels))

    def _rows(self, joint: np.ndarray) -> np.ndarray:
        plates = self._agent_interface.plates(joint) if self.nameplate else ()
        ends = np.broadcast_to(np.array([0.0, 1.0], np.float32), (len(joint), 2))
        rows = np.concatenate((joint, *plates, ends), axis=-1, dtype=np.float32).take(self._sources, axis=1)
        return rows.reshape(-1, rows.shape[-1])

    @property
    def _zero(self) -> int:
        """Where the 0 is that ``_sources`` refers to; the 1 follows."""
        return sum(len(names) for names in field_names(self.scenario).values()) + self._figures * self.scenario.n_agents

    @cached_property
    def _sources(self) -> np.ndarray:
        """Where the figures of a row are in joint observation, nameplate figures, 0 and 1, (row, n_observation)."""
        scenario, n_agent = self.scenario, self.scenario.n_agents
        names = [field_names(scenario)[agent] for agent in scenario.agents]
        first = np.cumsum([0, *map(len, names)])
        sources = np.full((n_agent, len(self.fields) + self._figures + self._kind.shape[1]), self._zero, np.int64)
        for i, own in enumerate(names):
            sources[i, [self.fields.index(name) for name in own]] = first[i] + np.arange(len(own))
            sources[i, len(self.fields) :][: self._figures] = first[-1] + i + n_agent * np.arange(self._figures)
        sources[:, len(self.fields) + self._figures :] += self._kind.astype(np.int64)
        return sources

    def _means(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        each = (actions * self.reach).reshape(-1, self.scenario.n_agents, len(self.channels))
        return {kind: each[:, members[:, None], self.entries(kind)] for kind, members in self.members.items()}
