"""A learned policy under guard: what it does is held near a droop law wherever it was not trained to act.

    u = law + clip(w (policy - law), -d, d)        u, law and policy: entries of the action of an agent

- **Range.** w of an agent is 1 while all inputs of its network, and its nameplate whether the network sees it or not,
  are in the range that its card holds (``input_range``), and falls to 0 at ``SOFT`` widths of the range beyond it: the
  law alone. It comes back over ``RETURN_STEPS`` steps.
- **Place.** Where some agent stands in a place, or has a rating, that is outside of the range, the policy was not made
  for this team. Then deviations are bounded too, d is ``DEVIATION`` and not the whole range, and so is the gain: w is
  at most what keeps the slope of u by the own voltage below the linear stability bound (``slope_bounds``), or at the
  law's where that is above it.
- **Law.** ``droop-tuned`` where the scenario has tuned gains, else the untrained ``droop`` with its gains cut to
  ``MARGIN`` of the stability bound.

Each agent needs its own observation alone, and one bit at the beginning, whether all stand in known places. The law has
no word on channels other than clock and reactive power (a storage's draw, a return, routing): they are the policy's
while its inputs are in range, without a bound, and go to rest where they are not, as under the law alone.

All constants were chosen on the validation split (docs/transfer.md).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import RandomFeeders, Scenario, action_layout, field_names
from dcgrid_env.agents.policy.input_range import InputRange, by_moments, with_plates
from dcgrid_env.agents.policy.model_aided_policy import ModelAidedPolicy
from dcgrid_env.agents.policy.neural_network import PolicyError
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.slope_bounds import slope_bounds
from dcgrid_env.agents.policy.trial_guard import TriedPolicy
from dcgrid_env.agents.policy.unseen import on_purpose
from dcgrid_env.baselines import Controller, Droop, make_controller
from dcgrid_env.baselines.equipment_agents import EquipmentAgents
from dcgrid_env.baselines.laws.stability import PLACEMENTS, largest_stable
from dcgrid_env.baselines.score import REFERENCE

SOFT = 0.1
"""Widths of its range beyond which an input leaves nothing to the policy."""
RETURN_STEPS = 1000
"""Steps in which an agent that had left the range comes back to the policy."""
DEVIATION = {"clock": 0.25, "q": 0.3}
"""Largest deviation from the law in places that are not the trained ones, of a range of actions from -1 to 1."""
MARGIN = 0.5
"""Gain of the untrained law as a share of the stability bound."""
STEP = 0.02
"""Change of the voltage's deviation, in bands, from which slopes are found."""
FAMILY_MEMBERS = 16
"""Feeders whose bounds are looked at where they are random; the smallest holds for all."""
FIGURES = ("guard_law_pct", "guard_bound_pct", "guard_new_places_pct")
"""What a guard tells of itself: share of agents' steps that the law has had, of entries of actions that were held at
the largest deviation, and whether some agent stood in a place that the policy was not trained on."""


class GuardedPolicy:
    """A policy under guard, a controller; made by :func:`guarded`.

    It keeps what the agents have met since ``reset``, so reset it at the beginning of each run of episodes.

    Parameters
    ----------
    policy
        What is guarded.
    ranges
        Range of the inputs of each of its networks.
    law
        What it is held to; found at ``reset`` unless given.
    """

    def __init__(self, policy: Policy, ranges: Mapping[str, InputRange] | None, law: Controller | None = None):
        self.policy, self.observe, self.law = policy, policy.observe, law
        self.ranges = ranges

    def reset(self, env_info: Scenario) -> None:
        """Begin episodes; PolicyError where the policy does not fit the scenario, or nothing is known of its range."""
        self._equipment = EquipmentAgents(env_info)
        self.scenario = scenario = self._equipment.others
        with on_purpose():
            self.policy.reset(scenario)
        self._law = law_for(env_info) if self.law is None else self.law
        self._law.reset(scenario)
        self._seen = self.policy.interface if self.ranges is None else with_plates(self.policy)
        fields = self._seen.input_fields
        self._ranges = by_moments(self.policy.networks, fields) if self.ranges is None else dict(self.ranges)
        for name, names in fields.items():
            if name not in self._ranges or self._ranges[name].fields != names:
                has = self._ranges[name].fields if name in self._ranges else ()
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

    def act(self, observations: Any) -> Any:
        """Actions for observations, in the same form: a mapping of agents, or joint, (..., n_observation)."""
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
        """How far the inputs of each agent lie outside, at most over its inputs, (..., n_agent)."""
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
        """Whether the place or rating of some agent is outside of the range, bool, (...)."""
        of_place = {name: distance[..., self._ranges[name].of_place] for name, distance in beyond.items()}
        known = {name: distance for name, distance in of_place.items() if distance.shape[-1]}
        if not known:
            return np.zeros(next(iter(beyond.values())).shape[: -1 if "joint" in beyond else -2], bool)
        return np.asarray((self._of_agents(known) > SOFT).any(-1))

    def _stable_share(self, joint: np.ndarray, probed: Controller) -> np.ndarray:
        """Share of the policy in each entry of the action at which its slope stays below the bound, (..., n_action)."""
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
        """Add to what the guard tells of itself."""
        self._last = [np.asarray(share, np.float64) for share in shares]
        self._sums = [a + b for a, b in zip(self._sums, self._last, strict=True)] if self._steps else self._last
        self._steps += 1

    @property
    def info(self) -> dict[str, np.ndarray]:
        """What the guard did in the last step, ``FIGURES`` in %, (row,) or a number each; flat and finite."""
        return {name: 100.0 * share for name, share in zip(FIGURES, self._last, strict=True)}

    def episode_figures(self) -> list[dict[str, float]]:
        """``FIGURES`` as means over the steps since ``reset``, one mapping an environment."""
        means = np.atleast_1d(100.0 * np.array(self._sums).reshape(len(FIGURES), -1) / max(self._steps, 1))
        return [dict(zip(FIGURES, map(float, means_of_env), strict=True)) for means_of_env in means.T]


def guarded(policy: Policy | str | Path, law: Controller | None = None) -> GuardedPolicy | TriedPolicy:
    """A policy under guard.

    One that corrects the model-aided law is held to that law (``trial_guard``).

    Parameters
    ----------
    policy
        A policy, or what ``Policy.load`` takes.
    law
        A controller that it is held to; the tuned droop of the scenario at hand, or the untrained one, unless given.

    Returns
    -------
    GuardedPolicy
        A controller. It falls back by the range on the policy's card, or where there is none by the moments of its
        networks.

    Raises
    ------
    PolicyError
        For another law given to a policy that corrects the model-aided one.
    """
    chosen = policy if isinstance(policy, Policy) else Policy.load(policy)
    if isinstance(chosen, ModelAidedPolicy):
        if law is not None:
            raise PolicyError(f"{chosen.source}: it corrects the model-aided law, and is held to that; give no law")
        return TriedPolicy(chosen)
    return GuardedPolicy(chosen, None if chosen.card is None else chosen.card.inputs, law)


def law_for(scenario: Scenario, tuned: str | Path | None = None) -> Controller:
    """The law that policies are held to on a scenario: the tuned droop, or the droop within the stability bound.

    ValueError for a file ``tuned`` that does not have its gains.
    """
    try:
        return make_controller(REFERENCE, scenario, tuned)
    except ValueError:
        if tuned is not None:
            raise
    plain = Droop()
    if isinstance(scenario.feeder, RandomFeeders):
        members = [scenario.member(i * scenario.feeder.batch) for i in range(FAMILY_MEMBERS)]
    else:
        members = [scenario]
    k_q = min(largest_stable(member, k_p_mw_per_pu=0.0) for member in members)
    k_q = min(plain.k_q_mvar_per_pu_s, MARGIN * k_q)
    k_p = min(largest_stable(member, k_q_mvar_per_pu_s=k_q, alpha_per_s=plain.alpha_per_s) for member in members)
    return Droop(k_p_mw_per_pu=min(plain.k_p_mw_per_pu, MARGIN * k_p), k_q_mvar_per_pu_s=k_q)


def steepest(scenario: Scenario) -> tuple[float, float]:
    """The bounds of ``slope_bounds``, on random feeders the smallest over some of them."""
    if not isinstance(scenario.feeder, RandomFeeders):
        return slope_bounds(scenario, PLACEMENTS)
    members = [scenario.member(i * scenario.feeder.batch) for i in range(FAMILY_MEMBERS)]
    reactive, clock = np.min([slope_bounds(member, 1) for member in members], axis=0)
    return float(reactive), float(clock)


def guard_line(name: str, figures: Mapping[str, float]) -> str:
    """What the guard of a controller did, on one line; empty for one without."""
    if FIGURES[0] not in figures:
        return ""
    law, bound, new = (figures[field] for field in FIGURES)
    where = "some agents stand where it was not trained" if new else "all agents stand where it was trained"
    return (
        f"{name}: {where}; the law had {law:.0f} % of agents' steps, {bound:.0f} % of settings were held at the bound"
    )
