"""Rules of disconnection and return: delays of the slots, caps of the counters, and what is refused."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.ride_through.rules import RideThrough, UpsRideThrough
from dcgrid_env.devices.ride_through.voltage_curve import CURVES, RideThroughCurve
from dcgrid_env.scenario.serialization import to_data

TIMES: dict[str, Any] = {"return_delay_s": 4.0, "by_hand_s": 50.0, "stagger_s": 7.0, "lockout_window_s": 45.0}


@pytest.mark.parametrize(
    ("release", "delay_s", "release_s", "longest_s"),
    [
        ("by hand", [4.0, 4.0, 4.0], [50.0, 50.0, 50.0], 64.0),
        ("staggered", [4.0, 11.0, 18.0], [50.0, 57.0, 64.0], 64.0),
        ("agent", [4.0, 4.0, 4.0], [4.0, 4.0, 4.0], 64.0),
    ],
)
def test_delays_of_the_slots_worked_by_hand(release, delay_s, release_s, longest_s):
    figures = UpsRideThrough(curve="itic", release=release, **TIMES).figures(3)
    np.testing.assert_array_equal(figures.delay_s, delay_s)
    np.testing.assert_array_equal(figures.release_s, release_s)
    assert (figures.longest_s, figures.remembered_s, figures.window_s) == (longest_s, 90.0, 45.0)


def test_a_release_by_hand_is_never_before_the_delay_and_no_slots_have_no_stagger():
    soon: dict[str, Any] = TIMES | {"by_hand_s": 1.0}
    rule = UpsRideThrough(curve="itic", **soon)
    np.testing.assert_array_equal(rule.delays_s(2)[1], [4.0, 4.0])
    assert rule.longest_wait_s(0) == 1.0
    assert rule.longest_wait_s(1) == 4.0


def test_a_rule_without_lock_out_remembers_a_minute():
    figures = RideThrough(curve="itic", return_delay_s=20.0).figures(2)
    assert (figures.longest_s, figures.remembered_s, figures.window_s) == (20.0, 60.0, 0.0)
    np.testing.assert_array_equal(figures.release_s, [20.0, 20.0])
    rule = RideThrough(curve="itic")
    assert (rule.lockout_events, rule.returns_per_minute, rule.release) == (0, 0, "by hand")
    assert (rule.stagger_s, rule.by_hand_s) == (0.0, 0.0)


def test_elements_of_each_slot_have_its_own_curve():
    own = RideThroughCurve(under=((0.7, 2.0),), over=((1.3, 1.0), (1.5, 0.5)))
    figures = RideThrough(curve=("itic", own)).figures(2)
    under, over = CURVES["itic"].under, CURVES["itic"].over
    assert figures.n_under == 3
    np.testing.assert_array_equal(figures.threshold[0], [v for v, _ in under] + [-v for v, _ in over])
    np.testing.assert_array_equal(figures.time_s[0], [s for _, s in (*under, *over)])
    np.testing.assert_array_equal(figures.threshold[1], [0.7, -np.inf, -np.inf, -1.3, -1.5, -np.inf])
    np.testing.assert_array_equal(figures.time_s[1], [2.0, np.inf, np.inf, 1.0, 0.5, np.inf])


def test_several_curves_are_one_for_each_slot():
    rule = RideThrough(curve=("itic", "itic"))
    rule.check_slots(2)
    RideThrough(curve="itic").check_slots(5)
    with pytest.raises(FieldError, match="RideThrough: curve has 2 curves; give one, or one for each of 3"):
        rule.check_slots(3)


@pytest.mark.parametrize("curve", [(), None, 3, ("itic", 3)])
def test_what_is_no_curve_is_refused(curve):
    with pytest.raises(FieldError, match=r"RideThrough: curve is .*; give the name of a curve"):
        RideThrough(curve=curve)


def test_an_agent_returns_by_a_ramp():
    UpsRideThrough(curve="itic", walk_in_s=0.0)
    with pytest.raises(FieldError, match=r"walk_in_s is 0.0; give more than 0 s where the agent"):
        UpsRideThrough(curve="itic", walk_in_s=0.0, release="agent")


@pytest.mark.parametrize(
    "plain", [{"curve": "itic"}, {"curve": ["itic", {"under": [[0.9, 1.0]], "over": []}], "walk_in_s": 2.0}]
)
def test_the_plain_form_has_what_differs_from_the_defaults(plain):
    assert to_data(UpsRideThrough(**plain)) == plain
