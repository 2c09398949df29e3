"""Disconnection and reconnection: each rule on an explicit series of voltages and sags."""

import numpy as np
import pytest
import torch

from dcgrid_env import RideThrough, RideThroughCurve, UpsRideThrough
from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.ride_through import connection
from dcgrid_env.devices.ride_through.connection import Supply

DIP = (0.05, 0.3)
"""Seconds and share left: beyond ITIC's 0.02 s below 0.7."""


def course(rule, steps, volts=None, dips=None, pace=None, dt_s=1.0, like=None):
    """States of one slot after each of the steps: ``volts`` by step (1 elsewhere), ``dips`` by step, half a step in."""
    zero = np.zeros((1, 1)) if like is None else like
    state, states = connection.initial(rule, zero), []
    for k in range(steps):
        v = zero + (volts or {}).get(k, 1.0)
        duration_s, retained = (dips or {}).get(k, (0.0, 1.0))
        sags = zero[..., None] * 0.0 + (v.new_tensor if like is not None else np.array)(
            [duration_s, retained, dt_s / 2]
        )
        own = connection.by_rule(rule, dt_s) if pace is None else zero + pace(k)
        state = connection.advance(rule, state, Supply(None, v, v, sags), own, dt_s)
        states.append(state)
    return states


def shares(states):
    return [round(state.share.item(), 6) for state in states]


def ups(**changes):
    return UpsRideThrough(**{"curve": "itic", "return_delay_s": 2.0, "walk_in_s": 4.0, "by_hand_s": 8.0} | changes)


def test_a_sag_that_is_ridden_through_is_no_event():
    states = course(ups(), 4, dips={1: (0.02, 0.3), 2: (0.4, 0.75), 3: (9.0, 0.85)})
    assert shares(states) == [1.0] * 4
    assert states[-1].event_age_s.min() == 120.0


@pytest.mark.parametrize("dip", [(0.0201, 0.3), (0.51, 0.75), (10.1, 0.85)])
def test_a_sag_beyond_the_curve_trips_in_its_step(dip):
    states = course(ups(), 3, dips={1: dip})
    assert shares(states)[:3] == [1.0, 0.0, 0.0]
    assert [state.tripped.item() for state in states] == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("like", [None, torch.zeros(1, 1)], ids=["arrays", "tensors"])
def test_a_sag_that_leaves_no_voltage_trips(like):
    assert shares(course(ups(), 3, dips={1: (0.05, 0.0)}, like=like)) == [1.0, 0.0, 0.0]


def test_a_site_returns_after_its_delay_by_a_ramp():
    assert shares(course(ups(), 9, dips={1: DIP})) == [1.0, 0.0, 0.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.0]


def test_the_site_s_own_voltage_counts_in_a_sag():
    at = {"under": ((0.5, 0.0),)}
    assert shares(course(ups(curve=at), 2, dips={1: (0.05, 0.52)})) == [1.0, 1.0]
    assert shares(course(ups(curve=at), 2, volts={1: 0.95}, dips={1: (0.05, 0.52)})) == [1.0, 0.0]


@pytest.mark.parametrize(("dt_s", "steps"), [(1.0, 10), (0.1, 100), (2.5, 4)])
def test_slow_undervoltage_trips_after_the_curve_s_time(dt_s, steps):
    states = course(ups(), steps + 2, volts=dict.fromkeys(range(1, steps + 2), 0.85), dt_s=dt_s)
    assert shares(states)[: steps + 1] == [1.0] * steps + [0.0]


def test_voltage_that_recovers_in_time_starts_the_timer_anew():
    volts = dict.fromkeys(range(9), 0.85) | dict.fromkeys(range(10, 19), 0.85)
    states = course(ups(), 20, volts=volts)
    assert shares(states) == [1.0] * 20
    assert connection.counters(ups(), states[8])[2].item() == pytest.approx(0.9)


def test_overvoltage_trips_too():
    curve = RideThroughCurve(over=((1.1, 3.0), (1.2, 0.16)))
    rule = RideThrough(curve=curve, return_delay_s=2.0, walk_in_s=0.0)
    assert shares(course(rule, 5, volts=dict.fromkeys(range(5), 1.15))) == [1.0, 1.0, 0.0, 0.0, 0.0]
    assert shares(course(rule, 5, volts={1: 1.25})) == [1.0, 0.0, 0.0, 1.0, 1.0]


def test_no_return_while_the_voltage_is_out_of_order():
    states = course(ups(), 12, volts=dict.fromkeys(range(2, 7), 0.85), dips={1: DIP})
    assert shares(states)[1:10] == [0.0] * 8 + [0.25]


def test_three_events_in_a_minute_lock_out_until_released_by_hand():
    dips = {1: DIP, 20: DIP, 40: DIP}
    states = course(ups(), 60, dips=dips)
    assert shares(states)[39] == 1.0
    assert [state.locked.item() for state in states][39:50] == [0.0] + [1.0] * 9 + [0.0]
    assert shares(states)[48:54] == [0.0, 0.25, 0.5, 0.75, 1.0, 1.0]


def test_three_events_in_more_than_the_window_do_not():
    states = course(ups(), 80, dips={1: DIP, 30: DIP, 62: DIP})
    assert max(state.locked.item() for state in states) == 0.0


def test_a_further_event_after_a_release_begins_the_count_anew():
    states = course(ups(), 70, dips={1: DIP, 12: DIP, 20: DIP, 40: DIP})
    assert states[39].share.item() == 1.0
    assert [states[k].locked.item() for k in (20, 40, 45)] == [1.0, 0.0, 0.0]


def test_a_fourth_return_within_a_minute_waits():
    rule = ups(lockout_events=0, returns_per_minute=3, walk_in_s=0.0, return_delay_s=1.0)
    states = course(rule, 100, dips=dict.fromkeys((1, 11, 21, 31), DIP))
    away = [k for k, share in enumerate(shares(states)) if share == 0.0]
    assert [k for k in away if k < 31] == [1, 2, 11, 12, 21, 22]
    assert away[-1] == 62
    assert away[6:] == list(range(31, 63))


def test_an_agent_says_when_and_how_fast():
    rule = ups(release="agent", lockout_events=1)
    states = course(rule, 12, dips={1: DIP}, pace=lambda k: 0.0 if k < 6 or k == 8 else 0.2)
    assert shares(states) == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.4, 0.4, 0.6, 0.8, 1.0]
    assert [states[k].locked.item() for k in (5, 6)] == [1.0, 0.0]


def test_staggered_slots_return_one_after_the_other():
    rule = ups(release="staggered", stagger_s=3.0, walk_in_s=0.0)
    dips = {1: DIP}
    states = course(rule, 12, dips=dips, like=None)
    assert shares(states)[4] == 1.0
    zero, begun = np.zeros((1, 3)), []
    state = connection.initial(rule, zero)
    for k in range(14):
        sags = np.array([[[*dips.get(k, (0.0, 1.0)), 0.5]]])
        state = connection.advance(rule, state, Supply(None, zero + 1.0, zero + 1.0, sags), 1.0, 1.0)
        begun.append(state.share[0].copy())
    assert [int(np.argmax(np.array(begun)[2:, slot])) + 2 for slot in range(3)] == [4, 7, 10]


def test_two_sags_in_one_step_are_two_events():
    rule, one = ups(lockout_events=2), np.ones((1, 1))
    sags = np.array([[[*DIP, 40.0], [*DIP, 20.0]]])
    state = connection.advance(rule, connection.initial(rule, 0.0 * one), Supply(None, one, one, sags), 1.0, 60.0)
    assert state.locked.item() == 1.0
    assert state.event_age_s.tolist() == [[[20.0, 40.0]]]


def test_tensors_go_the_same_way():
    dips, volts = {1: DIP, 20: DIP, 40: DIP}, dict.fromkeys(range(60, 75), 0.85)
    on_numpy = course(ups(), 120, volts=volts, dips=dips)
    on_torch = course(ups(), 120, volts=volts, dips=dips, like=torch.zeros((1, 1), dtype=torch.float64))
    for a, b in zip(on_numpy, on_torch, strict=True):
        assert all(np.array_equal(x, y.numpy()) for x, y in zip(a, b, strict=True))


def test_the_speed_of_the_ramp_has_a_derivative():
    rule, zero = ups(release="agent"), torch.zeros((1, 1), dtype=torch.float64)
    away = connection.initial(rule, zero)._replace(share=zero + 0.25)
    pace = torch.full((1, 1), 0.1, dtype=torch.float64, requires_grad=True)
    connection.advance(rule, away, Supply(None, zero + 1.0, zero + 1.0, None), pace, 1.0).share.sum().backward()
    assert pace.grad is not None
    assert pace.grad.item() == 1.0


@pytest.mark.parametrize(
    ("kind", "changes", "said"),
    [
        (RideThrough, {"curve": "cbema"}, "curve is 'cbema'; choose one of itic"),
        (RideThrough, {"curve": 3}, "curve is 3; give the name of a curve"),
        (RideThrough, {"curve": "itic", "return_delay_s": -1.0}, r"return_delay_s is -1.0; give a finite number in"),
        (UpsRideThrough, {"curve": "itic", "battery_s": -1.0}, "battery_s is -1.0"),
        (UpsRideThrough, {"curve": "itic", "charge_efficiency": 1.1}, "charge_efficiency is 1.1"),
        (UpsRideThrough, {"curve": "itic", "release": "never"}, "release is 'never'; choose one of by hand, staggered"),
        (UpsRideThrough, {"curve": "itic", "release": "agent", "walk_in_s": 0.0}, "walk_in_s is 0.0; give more than 0"),
        (UpsRideThrough, {"curve": "itic", "lockout_events": -1}, "lockout_events is -1; give a whole number"),
    ],
)
def test_a_rule_that_cannot_be_is_refused(kind, changes, said):
    with pytest.raises(FieldError, match=said):
        kind(**changes)


@pytest.mark.parametrize("like", [np.zeros((1, 1)), torch.zeros(1, 1, dtype=torch.float64)], ids=["arrays", "tensors"])
@pytest.mark.parametrize("dt_s", [1.0, 0.5])
@pytest.mark.parametrize(("early", "counts"), [(0.9e-3, True), (1.1e-3, False)])
def test_times_are_compared_to_a_thousandth_of_a_step(like, dt_s, early, counts):
    """A delay of 2 s before a return, 8 s before a release, and 10 s to a slow trip below 0.9 p.u."""

    def after(v, **fields):
        full = connection.initial(ups(release="staggered", stagger_s=0.0), like)
        before = full._replace(**{name: like + value for name, value in fields.items()})
        if "timer_s" in fields:
            before = before._replace(timer_s=0.0 * full.timer_s + fields["timer_s"])
        return connection.advance(ups(), before, Supply(None, like + v, like + v, None), 0.25, dt_s)

    assert after(1.0, share=0.0, wait_s=2.0 - early * dt_s).share.item() == (0.25 if counts else 0.0)
    assert after(1.0, share=0.0, locked=1.0, wait_s=8.0 - early * dt_s).locked.item() == (0.0 if counts else 1.0)
    assert after(0.89, timer_s=10.0 - dt_s - early * dt_s).tripped.item() == (1.0 if counts else 0.0)
