"""Return by hand and staggered return: when sites behind a UPS come back by fixed rules, the droop beside them.

A site that is not locked out returns ``return_delay_s`` after its last event, one that is locked out ``by_hand_s``
after it, by the fastest ramp. Staggered, slot i waits i ``stagger_s`` longer than that, so that no two walk in
together. All times are those of the scenario's rule (``UpsRideThrough``), and both laws see what an agent sees:
``ups_wait`` and ``ups_locked``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dcgrid_env import Scenario, action_layout, field_names
from dcgrid_env.baselines.laws.droop import Droop


@dataclass
class ReturnByHand(Droop):
    """All sites return as soon as someone may release them, all at once. Parameters are those of the droop."""

    staggered: ClassVar[bool] = False

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError for a scenario whose agents do not decide over the return."""
        super().reset(env_info)
        rule = getattr(env_info.part("datacenter"), "ride_through", None)
        if rule is None or rule.release != "agent":
            raise ValueError(
                f"return rules: the sites of scenario {env_info.name!r} have no channel 'return'; give it "
                "datacenter_ride_through={'curve': .., 'release': 'agent'}"
            )
        slots = env_info.n_datacenters
        later = rule.stagger_s * np.arange(slots) * self.staggered
        self._delay_s = rule.return_delay_s + later
        self._release_s = max(rule.by_hand_s, rule.return_delay_s) + later
        self._longest_s = rule.longest_wait_s(slots)
        self._return_at = np.flatnonzero(action_layout(self.scenario).is_channel("return"))
        names = [name for own in field_names(self.scenario).values() for name in own]
        of_sites = ("ups_share", "ups_locked", "ups_wait")
        self._seen_at = [[i for i, name in enumerate(names) if name == field] for field in of_sites]

    def _act(self, joint: np.ndarray) -> np.ndarray:
        actions = super()._act(joint)
        share, locked, wait = (joint[..., at] for at in self._seen_at)
        due_s = np.where(locked > 0.5, self._release_s, self._delay_s)
        goes = (share > 0.0) | (wait * self._longest_s >= due_s - 1e-3)
        actions[..., self._return_at] = np.where(goes, 1.0, -1.0)
        return actions


@dataclass
class StaggeredReturn(ReturnByHand):
    """One site after the other returns. Parameters are those of the droop."""

    staggered: ClassVar[bool] = True
