"""The state of a batch of environments after a step, as tuples of arrays; how to take parts of it and join them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.engine.cost import reward
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.physics.connections import Placement
from dcgrid_env.engine.physics.state import State, VoltageFigures
from dcgrid_env.scenario.scenario import Scenario


class Transition(NamedTuple):
    """What a step (or a reset) led to, before any automatic reset; arrays over environments."""

    observation: np.ndarray
    """Joint observation, float32, (row, n_observation)."""
    reward: np.ndarray
    """(row,), or (row, n_agent) where the scenario's reward is local or a difference."""
    terminated: np.ndarray
    """The power flow has no solution, bool, (row,)."""
    truncated: np.ndarray
    """The horizon is reached, bool, (row,)."""
    costs: reward.Costs
    """Weighted terms of the team's cost, (row,) each."""
    voltages: VoltageFigures
    """What cost and info ask of the voltages."""
    cost_j: np.ndarray
    """The step's share of J times T, (row,): minus the team's reward."""
    j_so_far: np.ndarray
    """Sum of ``cost_j`` since the reset over T, (row,): J of the episode once it is over."""
    state: State
    loss_kw: np.ndarray
    """(row,)"""
    converged: np.ndarray
    """Whether the power flow has a solution, bool, (row,)."""
    trace_start: np.ndarray
    """Where each data centre's trace window begins, ``Episode.start``, (row, n_dc)."""
    buses: np.ndarray
    """Position in ``bus_ids`` of each agent's bus, (row, n_agent)."""
    fault: np.ndarray
    """What each fault strikes and when, ``Episode.fault``, (row, n_fault, 3)."""
    reward_vector: np.ndarray | None = None
    """Difference reward of each entry of the joint action, (row, n_action); None for another reward."""


class Snapshot(NamedTuple):
    """All that a simulation needs to go on from where it was; made by ``save``. Its arrays are never written to."""

    scenario: Scenario
    seeds: np.ndarray
    numbers: np.ndarray
    episode: episode.Episode
    step: np.ndarray
    noise: np.ndarray
    p_ref_next_kw: np.ndarray
    state: State
    measured: tuple[np.ndarray, ...]
    transition: Transition

    @property
    def over(self) -> np.ndarray:
        """Whether an environment's episode has ended, bool, (row,)."""
        return self.transition.terminated | self.transition.truncated


_DRAWN = ("key", "buses", "start", "sun", "begin_h", "fault", "sag", "request")
"""Fields of an episode that ``episode.assemble`` takes."""


def put_in(scenario: Scenario, now: Snapshot, drawn: Snapshot, env_indices: np.ndarray) -> Snapshot:
    """``now`` with the environments of ``drawn`` put in."""

    def put(old: Any, new: Any) -> Any:
        if old is None:
            return None
        if isinstance(old, np.ndarray):
            merged = old.copy()
            merged[env_indices] = new
            return merged
        merged = [put(a, b) for a, b in zip(old, new, strict=True)]
        return type(old)(*merged) if hasattr(old, "_fields") else tuple(merged)

    old_episode, new_episode = now.episode, drawn.episode
    drawn_in = (put(getattr(old_episode, name), getattr(new_episode, name)) for name in _DRAWN)
    state = put(now.state, drawn.state)
    return Snapshot(
        scenario=scenario,
        seeds=put(now.seeds, drawn.seeds),
        numbers=put(now.numbers, drawn.numbers),
        episode=episode.assemble(scenario, *drawn_in),
        step=put(now.step, drawn.step),
        noise=put(now.noise, drawn.noise),
        p_ref_next_kw=put(now.p_ref_next_kw, drawn.p_ref_next_kw),
        state=state,
        measured=put(now.measured, drawn.measured),
        transition=put(now.transition, drawn.transition)._replace(state=state),
    )


def taken(now: Snapshot, env_indices: np.ndarray, scenario: Scenario) -> Snapshot:
    """Some environments of a snapshot as one for another scenario with as many nodes and the same agents."""
    return _placed_anew(
        _over_envs(lambda array: array[env_indices], scenario, now), env_indices, np.arange(len(env_indices))
    )


def joined(scenario: Scenario, parts: Sequence[tuple[np.ndarray, Snapshot]]) -> Snapshot:
    """Snapshots as one for a scenario with as many nodes and the same agents, each at the indices before it."""
    n = sum(len(env_indices) for env_indices, _ in parts)
    if len(parts) == 1:
        return parts[0][1]._replace(scenario=scenario)

    def put(first: np.ndarray, *others: np.ndarray) -> np.ndarray:
        whole = np.empty((n, *first.shape[1:]), first.dtype)
        for (env_indices, _), values in zip(parts, (first, *others), strict=True):
            whole[env_indices] = values
        return whole

    moved = [_placed_anew(part, np.arange(len(env_indices)), env_indices) for env_indices, part in parts]
    return _over_envs(put, scenario, *moved)


def _over_envs(function: Callable[..., Any], scenario: Scenario, *snapshots: Snapshot) -> Snapshot:
    """A snapshot of a function of the arrays of others, one by one."""

    def over(*values: Any) -> Any:
        first = values[0]
        if first is None:
            return None
        if isinstance(first, np.ndarray):
            return function(*values)
        parts = [over(*same) for same in zip(*values, strict=True)]
        return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)

    whole = over(*(snapshot._replace(scenario=None) for snapshot in snapshots))  # pyright: ignore[reportArgumentType]
    return whole._replace(scenario=scenario, transition=whole.transition._replace(state=whole.state))


def _placed_anew(part: Snapshot, were: np.ndarray, are: np.ndarray) -> Snapshot:
    """A snapshot whose environments have moved to other indices of a batch: flat positions follow."""
    by = (are - were)[:, None, None]
    drawn, s = part.episode, part.scenario
    placed: Placement = drawn.placed
    anew = placed._replace(
        nodes=placed.nodes + by * s.feeder.n_node,
        legs=placed.legs + by * s.feeder.n_leg,
        nearest=placed.nearest + by * s.n_agents,
    )
    return part._replace(episode=drawn._replace(placed=anew))
