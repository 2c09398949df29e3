"""Guard a learned policy: limit its deviation from a droop law outside the conditions of its training.

    u = law + clip(w (policy - law), -d, d)        u, law and policy: entries of the action of an agent

- **Range.** The policy's card stores the range of the network inputs (``input_range``). The weight w of an agent is 1
  while all inputs and the nameplate, which the network need not use, are in this range. It decreases to 0, the law
  alone, at ``SOFT`` widths of the range outside it. It recovers over ``RETURN_STEPS`` steps.
- **Place.** If the location or rating of an agent is outside the range, the policy was not trained for this scenario.
  Then d is ``DEVIATION`` instead of the complete range. In addition, w is limited so the slope of u in the agent's
  voltage stays below the linear stability bound (``slope_bounds``), or the law's slope if that is larger.
- **Law.** ``droop-tuned`` if the scenario has tuned gains, otherwise the untrained ``droop`` with its gains limited to
  ``MARGIN`` of the stability bound.

Each agent needs only its observation and, at the beginning, one bit: whether all locations are known. The law does not
control channels other than clock and reactive power, such as a storage's power, reconnection or routing. The policy
controls them without a bound while its inputs are in range; otherwise they go to rest, as under the law alone.

All constants were chosen on the validation split (docs/transfer.md).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import RandomFeeders, Scenario, action_layout, field_names
from dcgrid_env.agents.policy.input_range import InputRange, recorded, with_plates
from dcgrid_env.agents.policy.model_aided_policy import ModelAidedPolicy
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.slope_bounds import slope_bounds
from dcgrid_env.agents.policy.trial_guard import TriedPolicy
from dcgrid_env.agents.policy.unseen import on_purpose, trained_scenarios
from dcgrid_env.baselines import Controller, Droop, make_controller
from dcgrid_env.baselines.equipment_agents import EquipmentAgents
from dcgrid_env.baselines.laws.stability import PLACEMENTS, largest_stable
from dcgrid_env.baselines.score import REFERENCE

SOFT = 0.1
"""Distance outside the range, in widths of the range, at which the law acts alone."""
RETURN_STEPS = 1000
"""Number of steps in which the weight of the policy recovers after an agent was out of range."""
DEVIATION = {"clock": 0.25, "q": 0.3}
"""Maximum deviation from the law at locations outside the training range; actions range from -1 to 1."""
MARGIN = 0.5
"""Gain of the untrained law as a fraction of the stability bound."""
STEP = 0.02
"""Change in voltage deviation, in bands, for the computation of slopes."""
MOST_STEPS = 10_000
"""Longest episodes over which a range of inputs is recorded; the scenario is named in the policy's file."""
FAMILY_MEMBERS = 16
"""Number of random feeders for which bounds are computed; the smallest bound is used for all."""
FIGURES = ("guard_law_pct", "guard_bound_pct", "guard_new_places_pct")
"""Names of the guard's statistics, in %: weight of the law, action entries at the maximum deviation, new locations."""


class GuardedPolicy:
    """Control with a guarded policy; use :func:`guarded` to create it.

    The controller has memory. Call ``reset`` at the beginning of each run of episodes.

    Parameters
    ----------
    policy
        Policy to guard.
    ranges
        Range of the inputs of each network; by default it is recorded on the training scenarios.
    law
        Law that limits the policy; chosen at ``reset`` by default.
    """

    def __init__(self, policy: Policy, ranges: Mapping[str, InputRange] | None, law: Controller | None = None):
        self.policy, self.observe, self.law = policy, policy.observe, law
        self.ranges = ranges

    def reset(self, env_info: Scenario) -> None:
        """Begin episodes; raise PolicyError if the policy does not fit the scenario or its input range is unknown."""
        ranges = self.ranges = self._recorded() if self.ranges is None else self.ranges
        self._ranges = dict(ranges)
        self._equipment = EquipmentAgents(env_info, set_points=self.policy.set_points)
        self.scenario = scenario = self._equipment.others
        with on_purpose():
            self.policy.reset(scenario)
        self._law = law_for(env_info) if self.law is None else self.law
        self._law.reset(scenario)
        self._seen = with_plates(self.policy)
        for name, names in self._seen.input_fields.items():
            if name not in ranges or ranges[name].fields != names:
                has = ranges[name].fields if name in ranges else ()
                raise PolicyError(
                    f"guard: the range of inputs of network {name} is of {', '.join(has) or 'nothing'}, on "
                    f"{scenario.name} it sees {', '.join(names)}; record it again"
                )
        layout, agents = action_layout(scenario), {agent: i for i, agent in enumerate(scenario.agents)}
        self._owner = np.array([agents[agent] for agent, _ in layout.names])
        self._is_clock, self._is_q = layout.is_channel("clock"), layout.is_channel("q")
        seen = [name for agent in scenario.agents for name in field_names(scenario)[agent]]
        self._v_step = np.array([STEP * (name == "v_deviation") for name in seen], np.float32)
        self._steepest: np.ndarray | None = None
        self._share: np.ndarray | float = 1.0
        self._new: np.ndarray | None = None
        self._sums: list[np.ndarray] = []
        self._steps = 0

    def _recorded(self) -> Mapping[str, InputRange]:
        """Return the range of the inputs on the scenarios that the policy was trained on; PolicyError without any."""
        try:
            trained = trained_scenarios(self.policy.trained_on)
            for scenario in trained:
                if scenario.horizon > MOST_STEPS:
                    raise ValueError(
                        f"{scenario.name} has {scenario.horizon} steps, more than {MOST_STEPS}; give its card"
                    )
            return recorded(self.policy, trained) or {}
        except (ValueError, OSError) as error:
            raise PolicyError(
                f"guard: the range of the policy's inputs is not on a card, and not known: {error}"
            ) from None

    def act(self, observations: Any) -> Any:
        """Return actions in the form of the observations: a mapping of agents, or joint, (..., n_observation)."""
        return self._equipment.act(observations, self._act)

    def _act(self, joint: np.ndarray) -> np.ndarray:
        probed = copy.copy(self._law)  # as it is before this step, for laws that remember one
        law, wanted = self._law.act(joint), self.policy.act(joint)
        beyond = {name: self._ranges[name].beyond(inputs) for name, inputs in self._seen.inputs(joint).items()}
        if self._new is None:
            self._new = self._in_new_places(beyond)
        within = np.clip(1.0 - self._of_agents(beyond) / SOFT, 0.0, 1.0)
        self._share = np.minimum(within, self._share + 1.0 / RETURN_STEPS)
        weight = self._share[..., self._owner]
        new = self._new[..., None]
        if self._new.any():
            weight = np.where(new, np.minimum(weight, self._stable_share(joint, probed)), weight)
        most = np.where(self._is_clock, DEVIATION["clock"], np.where(self._is_q, DEVIATION["q"], np.inf))
        most = np.where(new, most, np.inf)
        deviation = weight * (wanted - law)
        self._tell(1.0 - self._share.mean(-1), (np.abs(deviation) > most).mean(-1), self._new)
        return np.clip(law + np.clip(deviation, -most, most), -1.0, 1.0).astype(np.float32)

    def _of_agents(self, beyond: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the largest distance of each agent's inputs outside their range, (..., n_agent)."""
        if "joint" in beyond:
            return np.repeat(beyond["joint"].max(-1)[..., None], self.scenario.n_agents, -1)
        parts = {kind: distance.max(-1) for kind, distance in beyond.items()}
        groups = self.policy.interface.groups
        first = next(iter(parts.values()))
        of_agents = np.zeros((*first.shape[:-1], self.scenario.n_agents))
        for kind, values in parts.items():
            of_agents[..., groups[kind].agents] = values
        return of_agents

    def _in_new_places(self, beyond: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return whether the location or rating of any agent is outside the range, bool, (...)."""
        of_place = {name: distance[..., self._ranges[name].of_place] for name, distance in beyond.items()}
        known = {name: distance for name, distance in of_place.items() if distance.shape[-1]}
        if not known:
            return np.zeros(next(iter(beyond.values())).shape[: -1 if "joint" in beyond else -2], bool)
        return np.asarray((self._of_agents(known) > SOFT).any(-1))

    def _stable_share(self, joint: np.ndarray, probed: Controller) -> np.ndarray:
        """Return the weight of the policy at which each action entry's slope stays below its bound, (..., n_action)."""
        if self._steepest is None:
            reactive, clock = steepest(self.scenario)
            self._steepest = np.where(self._is_clock, clock, np.where(self._is_q, reactive, np.inf))
        sign = np.where(self._is_clock, 1.0, -1.0)  # at a higher voltage a faster clock, and less reactive power
        laws, slope = (
            sign * (act(joint + self._v_step) - act(joint - self._v_step)) / (2.0 * STEP)
            for act in (probed.act, self.policy.probe)
        )
        room = np.maximum(self._steepest - laws, 0.0)
        return np.where(slope > np.maximum(self._steepest, laws), room / np.maximum(slope - laws, 1e-9), 1.0)

    def _tell(self, *shares: np.ndarray) -> None:
        """Update the statistics of the guard."""
        self._last = [np.asarray(share, np.float64) for share in shares]
        self._sums = [a + b for a, b in zip(self._sums, self._last, strict=True)] if self._steps else self._last
        self._steps += 1

    @property
    def info(self) -> dict[str, np.ndarray]:
        """Return ``FIGURES`` of the last step, in %, each (row,) or a number; flat and finite."""
        return {name: 100.0 * share for name, share in zip(FIGURES, self._last, strict=True)}

    def episode_figures(self) -> list[dict[str, float]]:
        """Return ``FIGURES`` as means over the steps since ``reset``, one mapping for each environment."""
        means = np.atleast_1d(100.0 * np.array(self._sums).reshape(len(FIGURES), -1) / max(self._steps, 1))
        return [dict(zip(FIGURES, map(float, means_of_env), strict=True)) for means_of_env in means.T]


def guarded(policy: Policy | str | Path, law: Controller | None = None) -> GuardedPolicy | TriedPolicy:
    """Return a controller that guards a policy.

    A policy that corrects the model-aided law is guarded by that law (``trial_guard``).

    Parameters
    ----------
    policy
        A policy, or what ``Policy.load`` takes.
    law
        Controller that limits the policy. Default: the tuned droop of the scenario, or the untrained one.

    Returns
    -------
    GuardedPolicy
        Controller that uses the range on the policy's card. Without one, the range is recorded on the scenario that the
        policy was trained on.

    Raises
    ------
    PolicyError
        If the policy corrects the model-aided law and another law is passed.
    """
    chosen = policy if isinstance(policy, Policy) else Policy.load(policy)
    if isinstance(chosen, ModelAidedPolicy):
        if law is not None:
            raise PolicyError(f"{chosen.source}: it corrects the model-aided law, and is held to that; give no law")
        return TriedPolicy(chosen)
    return GuardedPolicy(chosen, None if chosen.card is None else chosen.card.inputs, law)


def law_for(scenario: Scenario, tuned: str | Path | None = None) -> Controller:
    """Return the law that guards policies on a scenario: the tuned droop, or the droop within the stability bound.

    Raises ValueError if the file ``tuned`` does not contain its gains.
    """
    try:
        return make_controller(REFERENCE, scenario, tuned)
    except ValueError:
        if tuned is not None:
            raise
    plain = Droop()
    members = _members(scenario)
    k_q = min(largest_stable(member, k_p_mw_per_pu=0.0) for member in members)
    k_q = min(plain.k_q_mvar_per_pu_s, MARGIN * k_q)
    k_p = min(largest_stable(member, k_q_mvar_per_pu_s=k_q, alpha_per_s=plain.alpha_per_s) for member in members)
    return Droop(k_p_mw_per_pu=min(plain.k_p_mw_per_pu, MARGIN * k_p), k_q_mvar_per_pu_s=k_q)


def steepest(scenario: Scenario) -> tuple[float, float]:
    """Return the bounds of ``slope_bounds``; on random feeders, the smallest of a sample."""
    if not isinstance(scenario.feeder, RandomFeeders):
        return slope_bounds(scenario, PLACEMENTS)
    reactive, clock = np.min([slope_bounds(member, 1) for member in _members(scenario)], axis=0)
    return float(reactive), float(clock)


def _members(scenario: Scenario) -> list[Scenario]:
    """Return a sample of the members of random feeders, or the scenario itself."""
    feeder = scenario.feeder
    if not isinstance(feeder, RandomFeeders):
        return [scenario]
    return [scenario.member(i * feeder.batch) for i in range(FAMILY_MEMBERS)]


def guard_line(name: str, figures: Mapping[str, float]) -> str:
    """Return a one-line summary of the guard's statistics; empty for a controller without a guard."""
    if FIGURES[0] not in figures:
        return ""
    law, bound, new = (figures[field] for field in FIGURES)
    where = "some agents stand where it was not trained" if new else "all agents stand where it was trained"
    return (
        f"{name}: {where}; the law had {law:.0f} % of agents' steps, {bound:.0f} % of settings were held at the bound"
    )
