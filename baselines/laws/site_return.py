"""Return by hand and staggered return: sites behind a UPS reconnect by fixed rules, and the droop drives the rest.

A site that is not locked out returns ``return_delay_s`` after its last event, one that is locked out ``release_s``
after it, by a ramp of ``pace`` times the fastest. Staggered, slot i waits i ``stagger_s`` longer than that, so that no
two walk in together. Times that are not given are those of the scenario's rule (``UpsRideThrough``), and both laws see
what an agent sees: ``ups_wait`` and ``ups_locked``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dcgrid_env import Scenario, UpsRideThrough, action_layout, field_names
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.parameter_checks import require_non_negative

SLOWEST_PACE = 0.1
"""Slowest ramp that is searched for, as a share of the fastest."""


@dataclass
class ReturnByHand(Droop):
    """All sites return as soon as someone may release them, all at once. Further parameters are those of the droop.

    Parameters
    ----------
    return_delay_s
        How long after its last event a site returns that is not locked out, s; None for that of the scenario's rule.
    release_s
        How long after its last event a site returns that is locked out, s; None for ``by_hand_s`` of the rule.
    pace
        How fast a site walks in, as a share of the fastest.
    """

    return_delay_s: float | None = None
    release_s: float | None = None
    pace: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        times = {name: value for name, value in self._times().items() if value is not None}
        require_non_negative("return rules", pace=self.pace, **times)
        if not 0.0 < self.pace <= 1.0:
            raise ValueError(f"return rules: pace is {self.pace}; give more than 0, at most 1")

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes.

        ValueError for a scenario whose agents do not decide over the return, or where ``ups_wait`` does not reach as
        far as this law waits.
        """
        super().reset(env_info)
        rule, slots = return_rule(env_info), env_info.datacenters.count
        later = self._later_s(rule) * np.arange(slots)
        delay_s = rule.return_delay_s if self.return_delay_s is None else self.return_delay_s
        release_s = rule.by_hand_s if self.release_s is None else self.release_s
        self._delay_s = max(delay_s, rule.return_delay_s) + later
        self._release_s = max(release_s, rule.return_delay_s) + later
        self._longest_s = rule.longest_wait_s(slots)
        latest_s = max(self._delay_s[-1], self._release_s[-1])
        if latest_s > self._longest_s + 1e-6:
            raise ValueError(
                f"return rules: the last site would return after {latest_s:g} s, but ups_wait of scenario "
                f"{env_info.name!r} counts to {self._longest_s:g} s; give shorter times, or that scenario a longer "
                "by_hand_s"
            )
        self._return_at = np.flatnonzero(action_layout(self.scenario).is_channel("return"))
        names = [name for agent_names in field_names(self.scenario).values() for name in agent_names]
        of_sites = ("ups_share", "ups_locked", "ups_wait")
        self._seen_at = [[i for i, name in enumerate(names) if name == field] for field in of_sites]

    def _times(self) -> dict[str, float | None]:
        """Times that may be given, by name."""
        return {"return_delay_s": self.return_delay_s, "release_s": self.release_s}

    def _later_s(self, rule: UpsRideThrough) -> float:
        """How much later each slot returns than the one before, s."""
        return 0.0

    def _act(self, joint: np.ndarray) -> np.ndarray:
        actions = super()._act(joint)
        share, locked, wait = (joint[..., columns] for columns in self._seen_at)
        due_s = np.where(locked > 0.5, self._release_s, self._delay_s)
        returns = (share > 0.0) | (wait * self._longest_s >= due_s - 1e-3)
        actions[..., self._return_at] = np.where(returns, self.pace, -1.0)
        return actions


@dataclass
class StaggeredReturn(ReturnByHand):
    """One site after the other returns. Further parameters are those of the return by hand.

    Parameters
    ----------
    stagger_s
        How much later each slot returns than the one before, s; None for that of the scenario's rule.
    """

    stagger_s: float | None = None

    def _times(self) -> dict[str, float | None]:
        return super()._times() | {"stagger_s": self.stagger_s}

    def _later_s(self, rule: UpsRideThrough) -> float:
        return rule.stagger_s if self.stagger_s is None else self.stagger_s


def has_return_channel(scenario: Scenario) -> bool:
    """Whether the agents of a scenario's sites decide over their return."""
    rule = scenario.datacenters.ride_through
    return rule is not None and rule.release == "agent"


def return_rule(scenario: Scenario) -> UpsRideThrough:
    """The rule of a scenario whose agents decide over the return; ValueError for another."""
    rule = scenario.datacenters.ride_through
    if rule is None or not has_return_channel(scenario):
        raise ValueError(
            f"return rules: the sites of scenario {scenario.name!r} have no channel 'return'; give it "
            "datacenters={'ride_through': {'curve': .., 'release': 'agent'}}"
        )
    return rule
