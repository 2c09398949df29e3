"""Corrections of the model-aided law under guard: they act where a trial on the feeder's model says that they pay.

At ``place`` the policy and the law alone are driven through episodes of the training split, on the feeder's model with
all agents at their places. Where the policy costs less in the mean it acts, else the law does. The trial uses what the
law is commissioned with, a model and the statistics of load, work and sun, and nothing that is measured later. If the
model is wrong (``sensing.r_model_share``), the law acts.
"""

from __future__ import annotations

from itertools import islice
from typing import Any, ClassVar

import numpy as np

from dcgrid_env import Scenario
from dcgrid_env.agents.policy.model_aided_policy import ModelAidedPolicy
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines.equipment_agents import EquipmentAgents
from dcgrid_env.baselines.rollout import as_driven, transitions

EPISODES = 4
"""Episodes of a trial, the same for policy and law."""
STEPS = 60
"""Their length at most."""
LAW_PCT = "guard_law_pct"
"""Name of the guard's statistic: share of agents' steps under the law, %; 0 or 100 in an episode."""


class TriedPolicy:
    """A policy that corrects the model-aided law, left out where the law alone did better in a trial.

    Made by ``guard.guarded``.

    Parameters
    ----------
    policy
        What is guarded.
    """

    scope: ClassVar[str] = ModelAidedPolicy.scope

    def __init__(self, policy: ModelAidedPolicy):
        self.policy, self.observe = policy, policy.observe
        self._pays: np.ndarray | None = None

    def reset(self, env_info: Scenario) -> None:
        """Begin episodes; PolicyError or ValueError where policy or law do not fit the scenario."""
        self._equipment = EquipmentAgents(env_info)
        self.scenario = self._equipment.others
        self.policy.corrects = None
        with on_purpose():
            self.policy.reset(self.scenario)
        self._pays = None
        fixed = [device.buses for device in self.scenario.devices if device.count]
        if all(buses is not None for buses in fixed):
            self._try(np.array([[self.scenario.feeder.index(bus) for buses in fixed for bus in buses or ()]]))

    def place(self, buses: np.ndarray) -> None:
        """Try the policy at these places, positions in ``bus_ids`` of the agents' buses, (row, n_agent).

        PolicyError for places of another shape.
        """
        places, is_other = np.asarray(buses), self._equipment.is_other
        if places.ndim != 2 or places.shape[1] != len(is_other):
            raise PolicyError(f"guard: buses has shape {places.shape}; give (row, {len(is_other)}), a place an agent")
        self._try(places[:, is_other])

    def _try(self, agent_buses: np.ndarray) -> None:
        places, place_index = np.unique(agent_buses, axis=0, return_inverse=True)
        if self._pays is None or not np.array_equal(places, self._tried):
            self._tried, self._verdicts = places, pays(self.policy, self.scenario, places)
        self._pays = self._verdicts[place_index.ravel()]
        self.policy.place(agent_buses)
        self.policy.corrects = self._pays

    def act(self, observations: Any) -> Any:
        """Actions for observations, in the same form: a mapping of agents, or joint, (..., n_observation)."""
        if self._pays is None:
            raise PolicyError("guard: the policy is tried at the agents' places; call place(buses) after reset")
        return self._equipment.act(observations, self.policy.act)

    @property
    def info(self) -> dict[str, np.ndarray]:
        """``LAW_PCT`` of each row, (row,); empty until the policy has been tried."""
        return {} if self._pays is None else {LAW_PCT: 100.0 * ~self._pays}


def pays(policy: ModelAidedPolicy, scenario: Scenario, places: np.ndarray) -> np.ndarray:
    """Whether a policy costs less than the law alone at each placement, bool, (m,).

    Parameters
    ----------
    policy
        What is tried; a copy is driven.
    scenario
        Its agents have converters, and none of them is equipment of the feeder.
    places
        Positions in ``bus_ids`` of the agents' buses, (m, n_agent).
    """
    if not scenario.sensing.r_model_share == scenario.sensing.x_model_share == 1.0:
        return np.zeros(len(places), bool)
    trial = as_driven(scenario.replace(split="train", horizon=min(scenario.horizon, STEPS)), policy)
    n_env = 2 * EPISODES * len(places)
    driver = ModelAidedPolicy(policy.networks, law=policy.law, scenario=policy.trained_on)
    driver.corrects = np.arange(n_env) < n_env // 2
    seeds = np.tile(np.arange(EPISODES), 2 * len(places)).tolist()
    buses = np.tile(np.repeat(places, EPISODES, axis=0), (2, 1))
    with on_purpose():
        course = transitions(trial, driver, seeds, "guard", {"buses": buses})
        next(course)
        cost_j = sum(step.cost_j for step in islice(course, trial.horizon))
        course.close()
    of_policy, of_law = np.asarray(cost_j).reshape(2, len(places), EPISODES).mean(-1)
    return of_policy < of_law
