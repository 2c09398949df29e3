"""A lower bound on the cost of an episode in which built-in controls move taps: continuous taps that obey no relay.

The program is that of ``equipment_program``, in which agents choose the taps of all regulators that have a control. A
tap may move as early and as far as the delays of its control allow, in either direction. Whole taps that follow relays
are among these trajectories, so the optimum is below the cost of every controller, apart from the grid's curvature.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env import ActingRelays, Forecast, Recorder, RegulatorControl, Scenario, acting_relays
from dcgrid_env.baselines.model_based.equipment_program import EquipmentProgram

_NARROWEST = 1e-3  # of a tap: no range is so narrow that it has no inside
_TOLERANCE = 1e-4  # share of the optimum to which it is found; the dual is a bound at any accuracy


def tap_bound(scenario: Scenario, episode: Forecast, replayed: Recorder) -> float:
    """Return a lower bound on the cost of an episode, on the grid linearised around a replay of it."""
    relays = acting_relays(scenario)
    assert relays is not None
    return _FreeTaps(scenario, relays, episode, replayed).solve(_TOLERANCE)[0]


class _FreeTaps(EquipmentProgram):
    """The program whose taps need not follow relays."""

    def __init__(self, scenario: Scenario, relays: ActingRelays, episode: Forecast, replayed: Recorder) -> None:
        super().__init__(_with_agents(scenario, relays), episode, keep_band=False)
        self.follow(replayed)
        self.retrace(replayed)
        rows, settings = relays.rows, relays.settings
        self.rest, self.position = self.taps[0, rows], self.taps[1:, rows]
        self.most = np.ceil(self.most)
        delayed_s = scenario.dt_s * np.arange(1, scenario.horizon + 1)[:, None] - settings.delay_s[rows]
        further = np.floor(delayed_s / settings.tap_delay_s[rows] + _NARROWEST)
        self._reach = np.where(delayed_s < 0.0, _NARROWEST, 1.0 + further)

    def ranges(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`EquipmentProgram`."""
        return np.maximum(self.rest - self._reach, self.lowest), np.minimum(self.rest + self._reach, self.highest)


def _with_agents(scenario: Scenario, relays: ActingRelays) -> Scenario:
    """The scenario in which the regulators with a control are agents, with the same weights of reactive power."""
    feeder: Any = scenario.feeder
    bank = feeder.network.regulator.bank
    regulators = dict.fromkeys(bank, "fixed") | {bank[row]: "agent" for row in relays.rows.tolist()}
    return scenario.replace(grid_control={"regulators": regulators, "regulator_settings": RegulatorControl()})
