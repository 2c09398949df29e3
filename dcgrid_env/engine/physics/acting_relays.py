"""Relays of the regulators that act during an episode: delays, voltage bands and the taps that they aim for."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices.tap_changer.regulator_set_points import RegulatorSetPoints
from dcgrid_env.devices.tap_changer.regulator_state import MOST_EVENTS, RegulatorState, initial_regulators
from dcgrid_env.devices.tap_changer.relay import RelayBand, RelaySettings, relay_settings, relay_volts
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.devices.tap_changer.timed_taps import next_taps
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution
from dcgrid_env.scenario.grid_control import Decider, regulator_deciders
from dcgrid_env.scenario.scenario import Scenario

_SAME_TIME = 1e-9  # of a step


class ActingRelays(NamedTuple):
    """Some of a scenario's regulators, n of them, in the order of their table."""

    rows: np.ndarray
    """Their rows in the table of regulators, int, (n,)."""
    steps: np.ndarray
    """Steps in a row after which a relay that is out of band moves the tap, int, (n,)."""
    further_steps: np.ndarray
    """Those after which it moves on, after the first tap of a sequence, int, (n,)."""
    settings: RelaySettings
    """Settings of all regulators of the feeder."""

    def volts(self, solution: ThreePhaseSolution) -> np.ndarray:
        """Relay volts, (..., n), in a ``ThreePhaseSolution``."""
        return relay_volts(self.settings, solution)[..., self.rows]

    def rest_volts(self, tap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest volts at which the taps rest, of the shape of ``tap`` (..., n); infinite at their ends."""
        s, rows = self.settings, self.rows
        low, high = self.band_volts
        return np.where(tap < s.highest[rows], low, -np.inf), np.where(tap > s.lowest[rows], high, np.inf)

    def settled(
        self, feeder: ThreePhaseFeeder, p_kw: np.ndarray, q_kvar: np.ndarray, source_pu: float, tap: Any = None
    ) -> np.ndarray:
        """Return the taps of all regulators at which these relays rest under constant loads, (row, n_regulator).

        Loads are (row, n_leg). The other regulators stay at ``tap``, (row, n_regulator), where all begin; None for the
        taps of the table.
        """
        acts = np.zeros(feeder.n_regulator)
        acts[self.rows] = 1.0
        rest = settled_taps(feeder, p_kw, q_kvar, source_pu, tap=tap, controlled=acts, settings=self.settings)
        return np.asarray(rest.tap)

    @property
    def band_volts(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest volts in band, (n,)."""
        target, half = self.settings.target_v[self.rows], self.settings.half_band_v[self.rows]
        return target - half, target + half


class BankControl:
    """The taps that the built-in control would choose for some regulators, step by step.

    It keeps the relays' timers, so use it once per step and create a new object for each episode. The volts after a
    tap within the step are predicted by ``volts_per_tap``. Taps of upstream regulators are taken into account only if
    these regulators are among the selected ones.

    Parameters
    ----------
    relays
        The regulators.
    dt_s
        Length of a step, s.
    integrating
        Whether timers count down in band.
    """

    def __init__(self, relays: ActingRelays, dt_s: float, integrating: bool) -> None:
        rows, whole = relays.rows, relays.settings
        of_rows = (values[rows] if values.ndim == 1 else values[np.ix_(rows, rows)] for values in whole)
        self._settings, self._dt_s, self._integrating = RelaySettings(*of_rows), float(dt_s), integrating
        self._state: RegulatorState | None = None

    @property
    def target_v(self) -> np.ndarray:
        """Target of the relay volts, (n,)."""
        return self._settings.target_v

    def taps(self, tap: np.ndarray, relay_v: np.ndarray) -> np.ndarray:
        """Return the taps at the end of the coming step from present taps and relay measurements, all (row, n)."""
        tap, relay_v = (np.ascontiguousarray(values, np.float64) for values in (tap, relay_v))
        state, settings = self._state, self._settings
        if state is None or state.tap.shape != tap.shape:
            state = initial_regulators(tap, relay_v)
        state = state._replace(tap=tap, relay_v=relay_v)
        band = RelayBand(*(values + 0.0 * tap for values in (settings.target_v, settings.half_band_v)))
        left_s, never_s = np.full((len(tap), 1), self._dt_s), np.full((len(tap), 1), np.inf)
        for _ in range(MOST_EVENTS):
            before = state.tap
            state, passed_s = next_taps(settings, state, band, left_s, never_s, self._integrating)
            state = state._replace(relay_v=state.relay_v + (state.tap - before) @ settings.volts_per_tap)
            left_s = left_s - passed_s
            if not (left_s > 0.0).any():
                break
        self._state = state
        return state.tap


def acting_relays(scenario: Scenario, decider: Decider = "controlled") -> ActingRelays | None:
    """Return the relays of the regulators that the given decider controls; None without such regulators.

    The default decider is the built-in control, also where agents choose its set points. The settings have the default
    set points.
    """
    feeder = scenario.feeder
    if not isinstance(feeder, ThreePhaseFeeder):
        return None
    deciders = regulator_deciders(scenario.grid_control, feeder)
    alike = ("controlled", "setpoint") if decider == "controlled" else (decider,)
    rows = np.array([row for row, of_row in enumerate(deciders) if of_row in alike], np.int64)
    if not len(rows):
        return None
    settings = scenario_relays(scenario)
    first, further = (_steps(delay_s[rows], scenario.dt_s) for delay_s in (settings.delay_s, settings.tap_delay_s))
    return ActingRelays(rows, first, further, settings)


@cached_on_owner
def scenario_relays(scenario: Scenario) -> RelaySettings:
    """Return the settings of all regulators of a scenario's three-phase feeder under the default set points."""
    feeder: Any = scenario.feeder
    settings = relay_settings(feeder)
    offset_v = scenario.grid_control.regulator_settings.offsets_v(feeder.network.regulator)
    half_band_v = settings.half_band_v.copy()
    for device in scenario.devices:
        if isinstance(device, RegulatorSetPoints):
            for rows, half_v in zip(map(list, device.members), device.rest_half_band_v, strict=True):
                half_band_v[rows] = half_v
    return settings._replace(target_v=settings.target_v + offset_v, half_band_v=half_band_v)


def _steps(delay_s: np.ndarray, dt_s: float) -> np.ndarray:
    return np.maximum(np.ceil(delay_s / dt_s - _SAME_TIME), 1.0).astype(np.int64)
