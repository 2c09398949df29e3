"""The battery of a UPS: energy and work are conserved."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env import UpsRideThrough
from dcgrid_env.devices.ride_through import ups_battery

SHARE = st.floats(0.0, 1.0)
RATED = np.array([100.0])


def one(value):
    return np.full((1, 1), value)


@given(SHARE, SHARE, SHARE, st.sampled_from(["serves", "waits"]), st.sampled_from([0.1, 1.0, 60.0]))
def test_what_goes_in_and_out_of_the_battery_is_what_it_holds(share, draw, stored, on_battery, dt_s):
    rule = UpsRideThrough(curve="itic", battery_s=20.0, recharge_share=0.3, on_battery=on_battery)
    p_kw, before = 100.0 * draw, 2000.0 * stored
    after, grid_kw, works = ups_battery.step(
        rule, one(before), one(share), one(p_kw), one(min(p_kw, 23.0)), one(0.7 * p_kw), RATED, dt_s
    )
    changed = rule.charge_efficiency * after.recharge_kw.item() * dt_s - after.battery_kw.item() * dt_s
    assert after.stored_kws.item() == pytest.approx(before + changed, abs=1e-6)
    assert 0.0 <= after.stored_kws.item() <= 2000.0
    assert 0.0 <= works.item() <= 1.0
    assert grid_kw.item() <= 100.0 + 1e-9
    if on_battery == "serves":
        assert grid_kw.item() + after.battery_kw.item() - after.recharge_kw.item() == pytest.approx(
            works.item() * p_kw, abs=1e-6
        )


def test_a_connected_site_with_a_full_battery_is_left_alone_to_the_bit():
    rule = UpsRideThrough(curve="itic")
    after, grid_kw, works = ups_battery.step(rule, one(30000.0), one(1.0), one(np.pi), one(1.0), one(1.5), RATED, 1.0)
    assert (grid_kw.item(), works.item(), after.stored_kws.item()) == (np.pi, 1.0, 30000.0)


def test_an_empty_battery_leaves_the_site_dark():
    rule = UpsRideThrough(curve="itic", battery_s=10.0)
    after, grid_kw, works = ups_battery.step(rule, one(25.0), one(0.0), one(50.0), one(23.0), one(27.0), RATED, 1.0)
    assert (grid_kw.item(), works.item(), after.stored_kws.item()) == (0.0, 0.5, 0.0)
    dark = ups_battery.step(rule, after.stored_kws, one(0.0), one(50.0), one(23.0), one(27.0), RATED, 1.0)
    assert (dark[0].battery_kw.item(), dark[2].item()) == (0.0, 0.0)


def test_recharging_keeps_to_its_share_and_to_the_rating():
    rule = UpsRideThrough(curve="itic", battery_s=10.0, recharge_share=0.1)
    low, _, _ = ups_battery.step(rule, one(0.0), one(1.0), one(50.0), one(23.0), one(27.0), RATED, 1.0)
    high, grid_kw, _ = ups_battery.step(rule, one(0.0), one(1.0), one(97.0), one(23.0), one(27.0), RATED, 1.0)
    assert (low.recharge_kw.item(), high.recharge_kw.item(), grid_kw.item()) == (10.0, 3.0, 100.0)


def test_a_step_on_grid_and_battery_worked_by_hand():
    rule = UpsRideThrough(curve="itic", battery_s=10.0, recharge_share=0.1, charge_efficiency=0.8)
    after, grid_kw, works = ups_battery.step(rule, one(500.0), one(0.25), one(40.0), one(20.0), one(12.0), RATED, 2.0)
    assert (grid_kw.item(), works.item()) == (10.0, 1.0)
    assert [field.item() for field in after] == [440.0, 30.0, 0.0, 9.0]
    waits = UpsRideThrough(curve="itic", battery_s=10.0, on_battery="waits")
    after, grid_kw, works = ups_battery.step(waits, one(500.0), one(0.25), one(40.0), one(20.0), one(12.0), RATED, 2.0)
    assert (grid_kw.item(), works.item()) == (10.0, 0.25)
    assert [field.item() for field in after] == [470.0, 15.0, 0.0, 0.0]
    back, grid_kw, _ = ups_battery.step(rule, one(995.0), one(1.0), one(40.0), one(20.0), one(12.0), RATED, 2.0)
    assert (back.recharge_kw.item(), grid_kw.item()) == (pytest.approx(3.125), pytest.approx(43.125))
    assert back.stored_kws.item() == pytest.approx(1000.0)


def test_a_site_that_a_fault_has_taken_has_recharged_nothing():
    rule = UpsRideThrough(curve="itic", charge_efficiency=0.8)
    state = ups_battery.BatteryState(
        np.array([[100.0, 100.0]]), np.zeros((1, 2)), np.array([[10.0, 10.0]]), np.ones((1, 2))
    )
    found = ups_battery.without_grid(rule, state, np.array([[0.0, 1.0]]), 2.0)
    np.testing.assert_allclose(found.stored_kws, [[84.0, 100.0]])
    np.testing.assert_allclose(found.recharge_kw, [[0.0, 10.0]])
