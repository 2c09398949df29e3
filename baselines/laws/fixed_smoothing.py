"""Power smoothing at a fixed profile: floor and ramps that never change, in the terms of NVML, with the droop.

A setting beyond what the scenario's agents may choose is cut there. The profiles are choices: no source gives typical
ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dcgrid_env import PowerSmoothing, Scenario, action_layout
from dcgrid_env.baselines.laws.droop import Droop
from dcgrid_env.baselines.parameter_checks import require_non_negative

PROFILES: Mapping[str, Mapping[str, Any]] = {
    "light": {"floor_share": 0.5, "ramp_up_w_per_s": 2400.0, "ramp_down_w_per_s": 2400.0},
    "strong": {"floor_share": 0.9, "ramp_up_w_per_s": 600.0, "ramp_down_w_per_s": 600.0},
}
"""Parameters of two profiles by name, for a GPU of the GB200. One has half of the rating as its floor and half a second
from zero to the rating. The other has the highest floor and two seconds. Without parameters the droop acts alone."""


@dataclass
class FixedSmoothing(Droop):
    """Sites that smooth their power at a fixed profile. Further parameters are those of the droop.

    Parameters
    ----------
    floor_share
        Floor as a share of the rating, 0 for none.
    ramp_up_w_per_s, ramp_down_w_per_s
        Fastest rise and fall of the draw, W/s a GPU.
    """

    floor_share: float = 0.65
    ramp_up_w_per_s: float = 1200.0
    ramp_down_w_per_s: float = 1200.0

    def __post_init__(self) -> None:
        super().__post_init__()
        ramps = {"ramp_up_w_per_s": self.ramp_up_w_per_s, "ramp_down_w_per_s": self.ramp_down_w_per_s}
        require_non_negative("smoothing", floor_share=self.floor_share, **ramps)
        for name, value in ramps.items():
            if value == 0.0:
                raise ValueError(f"smoothing: {name} is 0, at which a draw never changes; give more")

    def reset(self, env_info: Scenario) -> None:
        """Begin new episodes; ValueError for a scenario whose agents do not decide over floor and ramps."""
        super().reset(env_info)
        settings = smoothing_of(env_info)
        layout, up, down = action_layout(self.scenario), self.ramp_up_w_per_s, self.ramp_down_w_per_s
        floor = min(self.floor_share / settings.floor_share, 1.0) if settings.floor_share else 0.0
        actions = {
            "floor": 2.0 * floor - 1.0,
            "ramp_up": ramp_action(up / settings.ramp_up_w_per_s, settings.slowest_share),
            "ramp_down": ramp_action(down / settings.ramp_down_w_per_s, settings.slowest_share),
        }
        self._settings_at = [(np.flatnonzero(layout.is_channel(name)), action) for name, action in actions.items()]

    def _act(self, joint: np.ndarray) -> np.ndarray:
        actions = super()._act(joint)
        for columns, action in self._settings_at:
            actions[..., columns] = action
        return actions


def has_smoothing_channels(scenario: Scenario) -> bool:
    """Whether the agents of a scenario's sites decide over floor and ramps."""
    settings = scenario.datacenters.smoothing
    return settings is not None and settings.control == "agent"


def smoothing_of(scenario: Scenario) -> PowerSmoothing:
    """The settings of a scenario whose agents decide over floor and ramps; ValueError for another."""
    settings = scenario.datacenters.smoothing
    if settings is None or not has_smoothing_channels(scenario):
        raise ValueError(
            f"smoothing: the sites of scenario {scenario.name!r} have no channels 'floor' and 'ramp_up'; give it "
            "datacenters={'smoothing': {'control': 'agent'}}, or use the law 'droop'"
        )
    return settings


def ramp_action(share: float, slowest_share: float) -> float:
    """The action that sets a ramp, as a share of the fastest."""
    if slowest_share == 1.0:
        return 0.0
    return 1.0 - 2.0 * min(max(np.log10(share) / np.log10(slowest_share), 0.0), 1.0)
