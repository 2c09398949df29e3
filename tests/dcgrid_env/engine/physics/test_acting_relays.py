"""Taps that a built-in control would make, step by step: delays, the band, the ends, steps of any length."""

import numpy as np
import pytest

from dcgrid_env import acting_relays, load_feeder, make_scenario
from dcgrid_env.devices.tap_changer.relay import relay_settings, relay_volts
from dcgrid_env.engine.physics.acting_relays import BankControl
from dcgrid_env.powerflow import Control, solve_unbalanced
from helpers.three_phase import ieee13, ieee123

TAP_V = 0.75  # 0.00625 of 120 V
TARGET_V = 122.0


def banks(dt_s, integrating=False):
    relays = acting_relays(ieee13())
    assert relays is not None
    return BankControl(relays, dt_s, integrating)


def taps_under(volts_at_zero, dt_s, integrating=False):
    """Taps of the first regulator after each step, under volts at tap 0, (step,), that a tap moves by ``TAP_V``."""
    control, taps = banks(dt_s, integrating), [0.0]
    for at_zero in volts_at_zero:
        tap = np.array([[taps[-1], 0.0, 0.0]])
        taps.append(control.taps(tap, np.array([[at_zero, TARGET_V, TARGET_V]]) + TAP_V * tap)[0, 0])
    return np.array(taps)


@pytest.mark.parametrize("integrating", [False, True])
@pytest.mark.parametrize("dt_s", [0.1, 0.5, 1.0])
def test_first_delay_then_the_shorter_one(dt_s, integrating):
    taps = taps_under(np.full(round(25.0 / dt_s), TARGET_V - 3.0), dt_s, integrating)  # in band after three taps
    begins = dt_s * np.flatnonzero(np.diff(taps))
    np.testing.assert_allclose(begins, [15.0, 17.0, 19.0])  # a tap that is due at the end of a step is in the next


def test_a_timer_in_band_returns_to_zero_or_counts_down():
    volts = np.full(60, TARGET_V - 3.0)
    volts[14] = TARGET_V
    first = [np.flatnonzero(np.diff(taps_under(volts, 1.0, integrating)))[0] for integrating in (False, True)]
    assert first == [30, 17]


def test_a_long_step_has_all_its_taps_on_predicted_volts():
    assert taps_under([TARGET_V - 3.0], 60.0)[-1] == 3.0


@pytest.mark.parametrize(("volts", "end"), [(60.0, 16.0), (200.0, -16.0)])
def test_no_tap_beyond_the_ends_however_long_the_step(volts, end):
    assert taps_under([volts], 3600.0)[-1] == end


@pytest.mark.parametrize("dt_s", [7.0, 60.0, 300.0])
@pytest.mark.parametrize("multiplier", [0.5, 1.3])
def test_long_steps_end_within_a_tap_of_short_ones(dt_s, multiplier):
    """In truth, which differs from what is predicted within a step, and with regulators in series."""
    feeder = load_feeder("ieee34-3ph")
    relays = acting_relays(make_scenario("ieee34-3ph-published"))
    assert relays is not None
    p, q = multiplier * feeder.p_load_kw[None], multiplier * feeder.q_load_kvar[None]

    def measured(tap):
        control = Control(feeder.tap_ratio(tap))
        return relay_volts(relay_settings(feeder), solve_unbalanced(feeder, p, q, control=control))

    ends = []
    for length in (1.0, dt_s):
        control, tap = BankControl(relays, length, integrating=True), feeder.base_tap[None]
        for _ in range(round(900.0 / length)):
            tap = control.taps(tap, measured(tap))
        ends.append(tap)
    assert np.abs(ends[0] - ends[1]).max() <= 1.0
    low, high = relays.rest_volts(ends[1])
    assert ((low <= measured(ends[1])) & (measured(ends[1]) <= high)).all()


def test_relays_that_act_are_those_with_a_control_of_their_own():
    scenario = ieee13()
    assert acting_relays(scenario.replace(grid_control={"regulators": "fixed"})) is None
    assert acting_relays(make_scenario("toy6")) is None
    of_seconds = acting_relays(ieee123())
    assert of_seconds is not None
    assert of_seconds.steps.tolist() == [15, 30, 30, 30, 30, 30, 30]
    assert of_seconds.further_steps.tolist() == [2] * 7
    relays = acting_relays(scenario.replace(dt_s=60.0))
    assert relays is not None
    assert relays.steps.tolist() == [1, 1, 1]
    low, high = relays.rest_volts(np.array([[16.0, 0.0, -16.0]]))
    assert np.isneginf(low).tolist() == [[True, False, False]]
    assert np.isposinf(high).tolist() == [[False, False, True]]
    np.testing.assert_allclose((low + high)[0, 1], 2.0 * 122.0)
