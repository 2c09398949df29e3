"""Rows of training environments, with their observations, actions and rewards.

A row is an environment (``Rows``), an agent of one (``AgentRows``) or a channel of an agent (``ChannelRows``). The
classes convert joint observations to those of rows, and actions of rows to joint actions. They step nothing and need no
library, so vector environments of any library and controllers use the same ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces

from dcgrid_env import IDS, RandomFeeders, Scenario, action_layout, field_names, make_scenario, under_own_control
from dcgrid_env.agents.policy.agent_groups import PLAIN_CHANNELS
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.training.row_form import (
    Outputs,
    RowActions,
    RowForm,
    View,
    check_form,
    decision_steps,
    droop_gains,
    learning_form,
    learning_reward,
)

REACH = {"setpoint": (1.0, 1.0, 1.0), "change": (2.0, 0.5, 1.0), "droop": (0.5, 0.5, 1.0)}
"""Network output for an action of 1: clock, reactive set point and other channel."""


def make_rows(scenario: Scenario, form: RowForm | None = None, action_repeat: int = 1) -> Rows:
    """Return the rows of a form, see :class:`Rows`; by default those of ``gymnasium.make``."""
    form = form or RowForm()
    return {"joint": Rows, "shared": AgentRows, "channel": ChannelRows}[form.view](scenario, form, action_repeat)


def learning_rows(
    scenario: str | Scenario,
    view: View | None,
    outputs: Outputs | None,
    nameplate: bool | None,
    action_repeat: int | None,
    overrides: Mapping[str, object],
) -> Rows:
    """Return the rows with which training is fastest, except for what is given; see :func:`sb3_vec_env`."""
    check_form(view, outputs, nameplate)
    chosen = make_scenario(IDS.get(scenario, scenario) if isinstance(scenario, str) else scenario, **overrides)
    form = learning_form(chosen, view, outputs, nameplate)
    if form.nameplate and form.view == "joint":
        raise ValueError("nameplate is True with view 'joint'; choose view 'shared' or 'channel', or leave it out")
    cost = overrides.get("cost")
    named = {*overrides, *(cost if isinstance(cost, Mapping) else ())}
    if isinstance(chosen.feeder, RandomFeeders) and chosen.split == "train" and "feeder" not in named:
        chosen = chosen.replace(feeder=replace(chosen.feeder, batch=1))
    is_open = "reward" not in named and chosen.cost.reward == "shared" and chosen.split == "train"
    if is_open and form.view != "joint":
        chosen = learning_reward(chosen)
    if chosen.cost.reward == "difference" and (is_open or "reward" in named) and "default_action" not in named:
        chosen = chosen.replace(cost={"default_action": "droop" if form.outputs == "droop" else "previous"})
    return make_rows(chosen, form, action_repeat=decision_steps(chosen) if action_repeat is None else action_repeat)


class Rows:
    """One row for each environment, with the joint observation and action of ``gymnasium.make``.

    Parameters
    ----------
    scenario
        Scenario to control. The droop as the default action of a difference reward gets the gains of the form.
    form
        What a row is and what its action means. Corrections of a droop without gains are those of the tuned one.
    action_repeat
        Steps of the environment for which an action holds.

    Raises
    ------
    ValueError
        If a droop without gains has no tuned ones for the scenario, an environment is paid as agents alone, or
        ``action_repeat`` does not divide the horizon.
    """

    def __init__(self, scenario: Scenario, form: RowForm, action_repeat: int = 1):
        if form.view == "joint" and scenario.cost.reward == "local":
            raise ValueError(
                "reward is 'local', which pays each agent, with view 'joint'; choose 'shared' or 'channel'"
            )
        whole = isinstance(action_repeat, int | np.integer) and not isinstance(action_repeat, bool)
        if not whole or not 1 <= action_repeat <= scenario.horizon or scenario.horizon % action_repeat:
            raise ValueError(f"action_repeat is {action_repeat!r}; give a divisor of the horizon {scenario.horizon}")
        self.action_repeat = int(action_repeat)
        gains = (form.gains or droop_gains(scenario)) if form.outputs == "droop" else None
        if gains is not None and scenario.cost.default_action == "droop":
            scenario = scenario.replace(cost={"default_gains": tuple(gains)})
        self.scenario = scenario
        self._owner = np.zeros(1, np.int64)
        """Agent of each row of an environment that is paid alone, (row,)."""
        self.form = form._replace(gains=gains, scenario=scenario.name)
        kind = "joint" if form.view == "joint" else "shared"
        self._acting = PolicyInterface(scenario, kind, outputs=form.outputs, gains=gains)

    @property
    def per_env(self) -> int:
        """Number of rows of an environment."""
        return 1

    @property
    def n_decisions(self) -> int:
        """Actions of a row in an episode."""
        return self.scenario.horizon // self.action_repeat

    @property
    def n_observation(self) -> int:
        """Number of entries of a row's observation."""
        return sum(len(names) for names in field_names(self.scenario).values())

    @property
    def n_action(self) -> int:
        """Number of entries of a row's action."""
        return len(self.channels)

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels that rows drive; except in the view "channel", those of the entries of an action."""
        return tuple(channel for _, channel in action_layout(self.scenario).names)

    @cached_property
    def reach(self) -> np.ndarray:
        """Network output for an action of 1, float32, (n_channel,)."""
        clock, q, other = REACH[self.form.outputs]
        return np.array([{"clock": clock, "q": q}.get(channel, other) for channel in self.channels], np.float32)

    @property
    def further_channels(self) -> dict[str, tuple[str, ...]]:
        """Channels that a policy must list; see ``PolicyInterface.further_channels``."""
        return self._acting.further_channels

    @property
    def action_space(self) -> RowActions:
        """Actions of a row, with the form."""
        return RowActions(self.form, self.n_action)

    def observation_space(self, joint: spaces.Space[Any]) -> spaces.Box:
        """Return the observations of a row, from the space of joint observations."""
        assert isinstance(joint, spaces.Box)
        return joint

    def observed(self, joint: np.ndarray) -> np.ndarray:
        """Return the rows' observations, float32, (env and row, n_observation), of joint ones, (env, n)."""
        return joint

    def joint_action(self, joint: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Return the joint actions, (env, n), that actions of rows mean after joint observations.

        Parameters
        ----------
        joint
            Joint observations, (env, n).
        actions
            Actions of the rows, (env and row, n_action).
        """
        return self._acting.action(joint, self._outputs(actions))

    def driven(self, joint: np.ndarray, predict: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Return the joint action, where ``predict`` gives the rows' actions for their observations."""
        return self.joint_action(joint, predict(self.observed(joint)))

    def paid(self, transition: Any) -> np.ndarray:
        """Return the rewards of a step, (env, row): those of the scenario's ``cost.reward`` for each row."""
        if self.scenario.cost.reward == "difference":
            return self._differences(transition)
        if self.scenario.cost.reward == "local":
            return transition.reward[:, self._owner]
        return np.repeat(transition.reward[:, None], self.per_env, axis=1)

    def _differences(self, transition: Any) -> np.ndarray:
        return transition.reward.sum(-1, keepdims=True)

    def _outputs(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        """Return actions of rows as outputs of networks."""
        return {"joint": actions * self.reach}


class AgentRows(Rows):
    """One row for each agent of each environment, environment by environment, for one policy that drives all.

    Its observation has, in this order: the fields of every kind of agent, each once by name, 0 where an agent has no
    such field; with ``form.nameplate`` those that ``policy.interface`` adds; 1 for a data centre or 0 for another; a
    figure for each kind but inverters, 1 for an agent of it. Its action is (clock, q) and then the other channels of
    the agents, each once by name. Channels that an agent does not have, as an inverter's clock, are ignored.

    Parameters
    ----------
    scenario, form, action_repeat
        See :class:`Rows`.

    Raises
    ------
    ValueError
        If :class:`Rows` raises it, or if regulators or capacitor banks are among the agents.
    """

    def __init__(self, scenario: Scenario, form: RowForm, action_repeat: int = 1):
        if under_own_control(scenario, keep_set_points=True) is not scenario:
            raise ValueError(
                f"view is {form.view!r}; {scenario.name!r} has regulators or capacitor banks among its agents, which "
                "share no policy with the others: choose 'joint', or give under_own_control(scenario, "
                "keep_set_points=True)"
            )
        super().__init__(scenario, form, action_repeat)
        self._owner = np.arange(scenario.n_agents)
        """Agent of each row of an environment, (row,)."""
        groups = self._acting.groups
        self._plates = PolicyInterface(scenario, "shared", nameplate=True).plates if form.nameplate else None
        self._figures = 3 * form.nameplate
        self.fields = tuple(dict.fromkeys(name for group in groups.values() for name in group.fields))
        self.kinds = ("inverter", "datacenter", *(kind for kind in groups if kind not in PLAIN_CHANNELS))
        """Kinds of agents in the order of the rows of ``used``; all but the first have a figure in the observation."""
        self.members = {kind: np.arange(group.agents.start, group.agents.stop) for kind, group in groups.items()}
        """Positions of the agents of each kind among all."""
        self._kind = np.zeros((scenario.n_agents, len(self.kinds) - 1), np.float32)
        for i, kind in enumerate(self.kinds[1:]):
            self._kind[self.members.get(kind, []), i] = 1.0

    @property
    def per_env(self) -> int:
        """Rows of an environment."""
        return self.scenario.n_agents

    @property
    def n_observation(self) -> int:
        """Number of entries of a row's observation."""
        return self._sources.shape[1]

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels that rows drive."""
        of_kinds = self._acting.channels.values()
        return tuple(dict.fromkeys(("clock", "q", *(name for names in of_kinds for name in names))))

    def entries(self, kind: str) -> list[int]:
        """Positions in ``channels`` of the channels of agents of a kind, in their order."""
        return [self.channels.index(name) for name in self._acting.channels[kind]]

    def constant(self, kind: str) -> np.ndarray:
        """Return the entries of observations that are the same for all agents of a kind, 0 for others.

        (1, n_observation), and for rows of channels (channel, n_observation), channels in the order of ``entries``.
        """
        rows = np.zeros((1, self.n_observation), np.float32)
        start = len(self.fields) + self._figures
        rows[:, start : start + self._kind.shape[1]] = self._kind[self.members[kind][0]]
        return rows

    def columns(self, agent: str) -> np.ndarray:
        """Where a row's observation holds the agent's own observation, and its nameplate figures if there are any."""
        field_columns = [self.fields.index(name) for name in field_names(self.scenario)[agent]]
        return np.array(field_columns + [len(self.fields) + i for i in range(self._figures)])

    def observation_space(self, joint: spaces.Space[Any]) -> spaces.Box:
        """Return the observations of a row, from the space of joint observations."""
        whole = super().observation_space(joint)
        low, high = (self.observed(edge[None]).reshape(self.per_env, -1) for edge in (whole.low, whole.high))
        low, high = low.min(axis=0), high.max(axis=0)
        plate = slice(len(self.fields), len(self.fields) + self._figures)
        low[plate], high[plate] = -np.inf, np.inf
        low[plate.stop :], high[plate.stop :] = 0.0, 1.0
        return spaces.Box(low, high, dtype=np.float32)

    def observed(self, joint: np.ndarray) -> np.ndarray:
        """Return the rows' observations, float32, (env and row, n_observation), of joint ones, (env, n)."""
        plates = () if self._plates is None else self._plates(joint)
        ends = np.broadcast_to(np.array([0.0, 1.0], np.float32), (len(joint), 2))
        rows = np.concatenate((joint, *plates, ends), axis=-1, dtype=np.float32).take(self._sources, axis=1)
        return rows.reshape(-1, rows.shape[-1])

    @property
    def _zero(self) -> int:
        """Position of the 0 that ``_sources`` refers to; the 1 follows."""
        return sum(len(names) for names in field_names(self.scenario).values()) + self._figures * self.scenario.n_agents

    @cached_property
    def _sources(self) -> np.ndarray:
        """Positions of a row's figures in joint observation, nameplate figures, 0 and 1, (row, n_observation)."""
        scenario, n_agent = self.scenario, self.scenario.n_agents
        names = [field_names(scenario)[agent] for agent in scenario.agents]
        first = np.cumsum([0, *map(len, names)])
        sources = np.full((n_agent, len(self.fields) + self._figures + self._kind.shape[1]), self._zero, np.int64)
        for i, own in enumerate(names):
            sources[i, [self.fields.index(name) for name in own]] = first[i] + np.arange(len(own))
            sources[i, len(self.fields) :][: self._figures] = first[-1] + i + n_agent * np.arange(self._figures)
        sources[:, len(self.fields) + self._figures :] += self._kind.astype(np.int64)
        return sources

    def _differences(self, transition: Any) -> np.ndarray:
        return transition.reward

    def _outputs(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        each = (actions * self.reach).reshape(-1, self.scenario.n_agents, len(self.channels))
        return {kind: each[:, members[:, None], self.entries(kind)] for kind, members in self.members.items()}


class ChannelRows(AgentRows):
    """One row for each channel of each agent, in the order of the joint action.

    A row observes what its agent observes in ``AgentRows``, then a figure for each channel, 1 for its own and 0 for the
    others. Its action is that entry alone. Likelihood and difference reward therefore belong to one channel, without
    the noise of the others.

    Parameters
    ----------
    scenario, form, action_repeat
        See :class:`AgentRows`.
    """

    def __init__(self, scenario: Scenario, form: RowForm, action_repeat: int = 1):
        super().__init__(scenario, form, action_repeat)
        names, agents = action_layout(scenario).names, {agent: i for i, agent in enumerate(scenario.agents)}
        self._owner = np.array([agents[agent] for agent, _ in names])
        self._of_names = [name for _, name in names]

    @property
    def per_env(self) -> int:
        """Rows of an environment."""
        return len(self._owner)

    @property
    def n_action(self) -> int:
        """Number of entries of a row's action: its channel's."""
        return 1

    def constant(self, kind: str) -> np.ndarray:
        """Return the entries that are the same for all agents of a kind, (channel, n_observation), 0 for others."""
        entries = self.entries(kind)
        rows = np.repeat(super().constant(kind), len(entries), axis=0)
        rows[:, -len(self.channels) :] = np.eye(len(self.channels), dtype=np.float32)[entries]
        return rows

    @cached_property
    def _column(self) -> np.ndarray:
        """Channel of each row of an environment, (row,)."""
        return np.array([self.channels.index(name) for name in self._of_names])

    @cached_property
    def _sources(self) -> np.ndarray:
        code = np.eye(len(self.channels), dtype=np.int64)[self._column]
        return np.concatenate((super()._sources[self._owner], self._zero + code), axis=1)

    def _differences(self, transition: Any) -> np.ndarray:
        return transition.reward_vector

    def _outputs(self, actions: np.ndarray) -> dict[str, np.ndarray]:
        entries = actions.reshape(-1, len(self._owner))
        of_agents = np.zeros((len(entries), self.scenario.n_agents, len(self.channels)), np.float32)
        of_agents[:, self._owner, self._column] = entries
        return super()._outputs(of_agents.reshape(-1, len(self.channels)))
