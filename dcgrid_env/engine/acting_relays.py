"""The relays of the regulators that change taps by themselves: for how long, and within what volts, they leave them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.devices.tap_changer.relay import RelaySettings, relay_settings, relay_volts
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.scenario.grid_control import regulator_deciders
from dcgrid_env.scenario.scenario import Scenario

_SAME_TIME = 1e-9  # of a step


class ActingRelays(NamedTuple):
    """The regulators of a scenario that follow the control of their bank, n of them, in the order of their table."""

    rows: np.ndarray
    """Their rows in the table of regulators, int, (n,)."""
    steps: np.ndarray
    """Steps in a row after which a relay that is out of band moves the tap, int, (n,)."""
    settings: RelaySettings
    """Settings of all regulators of the feeder."""

    def volts(self, solution: Any) -> np.ndarray:
        """Relay volts, (..., n), in a ``ThreePhaseSolution``."""
        return relay_volts(self.settings, solution)[..., self.rows]

    def rest_volts(self, tap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest volts at which the taps rest, of the shape of ``tap`` (..., n); infinite at their ends."""
        s, rows = self.settings, self.rows
        low, high = s.target_v[rows] - s.half_band_v[rows], s.target_v[rows] + s.half_band_v[rows]
        return np.where(tap < s.highest[rows], low, -np.inf), np.where(tap > s.lowest[rows], high, np.inf)


def acting_relays(scenario: Scenario) -> ActingRelays | None:
    """The relays of the regulators that a control of their own moves; None where there is none."""
    feeder = scenario.feeder
    if not isinstance(feeder, ThreePhaseFeeder):
        return None
    deciders = regulator_deciders(scenario.grid_control, feeder)
    rows = np.array([row for row, decider in enumerate(deciders) if decider == "controlled"], np.int64)
    if not len(rows):
        return None
    settings = relay_settings(feeder)
    steps = np.maximum(np.ceil(settings.delay_s[rows] / scenario.dt_s - _SAME_TIME), 1.0).astype(np.int64)
    return ActingRelays(rows, steps, settings)
