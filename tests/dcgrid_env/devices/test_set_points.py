"""Set points that are taken over from time to time, and the ranges in which agents request them."""

import numpy as np
import pytest

from dcgrid_env import load_feeder
from dcgrid_env.devices import Device
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.capacitor_bank.threshold_set_points import ThresholdSetPoints
from dcgrid_env.devices.set_points import in_force, observed_age
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.devices.tap_changer.regulator_set_points import RegulatorSetPoints

FEEDER = load_feeder("ieee13-3ph")
BANK = RegulatorSetPoints.of_feeder(FEEDER, (0, 1, 2), RegulatorControl(timer="reset"))
THRESHOLDS = ThresholdSetPoints.of_feeder(FEEDER, (0, 1), CapacitorControl())


@pytest.mark.parametrize(
    ("age_s", "asked", "found", "age_after_s"),
    [
        (59.9, (2.0, 1.0), (0.0, 1.0), 60.4),
        (60.0, (2.0, 1.0), (2.0, 1.0), 0.5),
        (60.0 - 1e-7, (2.0, 1.0), (2.0, 1.0), 0.5),
        (60.0, (0.0, 1.2), (0.0, 1.2), 0.5),
        (60.0, (0.0, 1.0), (0.0, 1.0), 60.5),
        (60.0, (5e-5, 1.0 - 5e-5), (0.0, 1.0), 60.5),
        (60.0, (-2e-4, 1.0), (-2e-4, 1.0), 0.5),
    ],
)
def test_a_change_needs_a_set_point_of_that_age_and_a_difference(age_s, asked, found, age_after_s):
    one = np.ones((1, 1))
    given = (asked[0] * one, asked[1] * one), (0.0 * one, one), age_s * one
    first, second, after_s = in_force(*given, np.array([60.0]), 1e-4, 0.5)
    assert (first.item(), second.item()) == found
    assert after_s.item() == pytest.approx(age_after_s)


def test_the_age_is_observed_up_to_the_time_of_a_change():
    assert observed_age(np.array([[0.0, 59.0, 61.0]]), np.array([60.0] * 3)).tolist() == [[0.0, 59.0, 60.0]]


def test_the_ranges_of_a_bank_begin_at_half_a_tap():
    offset, half = BANK.channels
    assert (offset.lowest.item(), offset.highest.item(), offset.rest.item()) == (-4.0, 4.0, 0.0)
    assert (half.lowest.item(), half.highest.item(), half.rest.item()) == (0.375, 3.0, 1.0)
    assert (BANK.names, BANK.buses, BANK.phases, BANK.target_v) == (("reg1",), ("rg60",), ("abc",), (122.0,))


def test_thresholds_keep_a_gap_and_extend_to_those_of_the_scenario():
    centre, half = THRESHOLDS.channels
    np.testing.assert_allclose([centre.rest, half.rest], [[1.01] * 2, [0.03] * 2])
    assert (centre.lowest == 0.95).all()
    assert (centre.highest == 1.05).all()
    assert (half.lowest == 0.01).all()
    wide = ThresholdSetPoints.of_feeder(FEEDER, (0,), CapacitorControl(on_below_pu=0.8, off_above_pu=1.0))
    assert (wide.channels[0].lowest.item(), wide.channels[1].highest.item()) == pytest.approx((0.9, 0.1))


@pytest.mark.parametrize("device", [BANK, THRESHOLDS], ids=["regulators", "capacitors"])
def test_they_are_devices_without_power(device):
    state = device.initial(device.parameters, np.zeros((2, device.count)))
    rest = tuple(np.zeros((2, device.count)) + channel.rest for channel in device.channels)
    after, drawn = device.step(device.parameters, state, rest, None, 1.0)
    assert (drawn == 0.0).all()
    assert (after.setpoint_age_s == 61.0).all()
    assert device.cost_terms(10, 1.0) == ()
    assert len(device.fields(10, 1.0)) == len(device.observe(device.parameters, state, None))
    assert (device.q_limit_kvar == 0.0).all()
    assert isinstance(device, Device)
