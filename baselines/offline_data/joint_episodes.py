"""Episodes as the joint environment gives them: observations, actions, rewards and the terms of the cost."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dcgrid_env import Scenario, action_layout, field_names, info_arrays
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.offline_data.behaviour import Behaviour
from dcgrid_env.baselines.rollout import as_driven, transitions


@dataclass(frozen=True)
class JointEpisode:
    """One episode of ``gymnasium.make``: T steps, and T + 1 rows of what is observed.

    Arrays hold what the environment gives, bit by bit.
    """

    seed: int
    """Seed of ``reset``."""
    observations: np.ndarray
    """(T + 1, n_observation), float32."""
    actions: np.ndarray
    """(T, n_action), float32, in [-1, 1]."""
    controller: str
    """Name of the controller."""
    rewards: np.ndarray
    """The team's reward, or the sum over the agents of a difference reward, (T,), float64."""
    terminations: np.ndarray
    """(T,), bool; the power flow has no solution."""
    truncations: np.ndarray
    """(T,), bool; the horizon is reached."""
    infos: Mapping[str, np.ndarray]
    """Every figure of ``info``, (T + 1,) each, float64. Difference rewards add ``reward_vector``, (T + 1, n_action)."""
    buses: Mapping[str, str]
    """Bus of each agent."""

    @property
    def J(self) -> float:
        """Cost of the episode."""
        return float(self.infos["J"][-1])


def joint_episodes(
    scenario: Scenario,
    controller: Controller,
    seeds: Sequence[int],
    *,
    noise: float = 0.0,
    behaviour_seed: int = 0,
    on_step: Callable[[], None] | None = None,
    name: str | None = None,
) -> list[JointEpisode]:
    """Drive one episode for each seed to its end, all at once.

    Parameters
    ----------
    scenario
        Scenario to run; its split determines the episode of each seed.
    controller
        Controller to run. It must use the scenario's scope of observation, which the episodes contain.
    seeds
        One episode each.
    noise, behaviour_seed
        See :class:`Behaviour`.
    on_step
        Called after each step.
    name
        Name of the controller, also in errors. Default: that of its class.

    Raises
    ------
    ValueError
        For a controller that needs another scope of observation.
    ControllerError
        See ``rollout``.
    """
    needed = as_driven(scenario, controller).sensing.observe
    name = type(controller).__name__ if name is None else name
    if needed != scenario.sensing.observe:
        raise ValueError(
            f"controller {name!r} observes {needed!r}, and the episodes would hold "
            f"{scenario.sensing.observe!r}; set the scenario's field observe to {needed!r}"
        )
    episodes: dict[int, JointEpisode] = {}
    for member, env_indices in scenario.members(seeds):
        member_seeds = [seeds[env_index] for env_index in env_indices.tolist()]
        driver = Behaviour(controller, member_seeds, noise, behaviour_seed)
        for episode in _driven(member, driver, member_seeds, on_step, name):
            episodes[episode.seed] = episode
    return [episodes[seed] for seed in seeds]


def _driven(
    scenario: Scenario,
    driver: Behaviour,
    seeds: Sequence[int],
    on_step: Callable[[], None] | None,
    name: str,
) -> Iterator[JointEpisode]:
    """Run the environments until the last of them has ended, and give the episode of each."""
    steps = transitions(scenario, driver, seeds, name)
    passed = [next(steps)]
    lengths = np.zeros(len(seeds), dtype=np.int64)
    while not lengths.all():
        passed.append(next(steps))
        over = passed[-1].terminated | passed[-1].truncated
        lengths[over & (lengths == 0)] = len(passed) - 1
        if on_step is not None:
            on_step()
    steps.close()
    observed = np.stack([t.observation for t in passed])
    rewards = np.stack([t.reward if t.reward.ndim == 1 else t.reward.sum(-1) for t in passed])
    terminated, truncated = np.stack([t.terminated for t in passed]), np.stack([t.truncated for t in passed])
    figures = [info_arrays(scenario, transition) for transition in passed]
    infos = {key: np.stack([row[key] for row in figures]) for key in figures[0]}
    if scenario.cost.reward == "difference":
        infos["reward_vector"] = np.stack([t.reward_vector for t in passed])
    actions, bus_ids = np.stack(driver.actions), scenario.feeder.bus_ids
    for env_index, (seed, n) in enumerate(zip(seeds, lengths.tolist(), strict=True)):
        yield JointEpisode(
            seed=seed,
            controller=name,
            observations=observed[: n + 1, env_index].copy(),
            actions=actions[:n, env_index].copy(),
            rewards=rewards[1 : n + 1, env_index].copy(),
            terminations=terminated[1 : n + 1, env_index].copy(),
            truncations=truncated[1 : n + 1, env_index].copy(),
            infos={key: values[: n + 1, env_index].astype(np.float64) for key, values in infos.items()},
            buses={a: str(bus_ids[b]) for a, b in zip(scenario.agents, driver.buses[env_index], strict=True)},
        )


def agent_layout(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Return each agent's kind, and its slices and entry names in the joint observation and action."""
    layout, fields = action_layout(scenario), field_names(scenario)
    kinds = [device.kind for device in scenario.devices for _ in range(device.count)]
    layouts: dict[str, dict[str, Any]] = {}
    begin = 0
    for agent, kind in zip(scenario.agents, kinds, strict=True):
        cut, end = layout.slices[agent], begin + len(fields[agent])
        layouts[agent] = {
            "kind": kind,
            "observation": [begin, end],
            "action": [cut.start, cut.stop],
            "fields": list(fields[agent]),
            "channels": [channel for owner, channel in layout.names if owner == agent],
        }
        begin = end
    return layouts
