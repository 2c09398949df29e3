"""Peak shaving by hand and in the environment: when it gives, when it takes back, and what it is worth."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import Scenario, make_scenario
from dcgrid_env.baselines import Droop, Local, PeakShaving, find_controller, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight
from helpers.storages import ieee33_weak_ups, toy6_storage


def draw(v_pu, stored_kwh=2.5, p_kw=0.0, scenario: Scenario | None = None, **parameters):
    """What the law draws of two storages of 300 kW and 5 kWh, of which 2.5 are to be returned, on toy6."""
    given: Any = {"v_hold_pu": 0.97, "gain": 0.5} | parameters
    law = PeakShaving(**given)
    law.reset(scenario or toy6_storage())
    one, pair = np.ones(5), np.array([0.0, 0.0, 0.0, 1.0, 1.0])
    local = Local(
        v_pu * one, p_kw * pair, 0.0 * one, np.ones(1), np.zeros(1), 0.05 * one, 0.1 * one, np.full(2, stored_kwh)
    )
    return law.draw(local)


@pytest.mark.parametrize(
    ("seen", "kw"),
    [
        ({"v_pu": 0.97}, 0.0),
        ({"v_pu": 0.96}, -100.0),  # half of 0.01 p.u. at 0.05 p.u. for each MW
        ({"v_pu": 0.96, "p_kw": -50.0}, -150.0),
        ({"v_pu": 0.90}, -300.0),
        ({"v_pu": 0.98, "p_kw": -150.0}, -50.0),
        ({"v_pu": 0.98, "stored_kwh": 2.4}, 100.0),
        ({"v_pu": 1.02, "stored_kwh": 2.4}, 300.0),
        ({"v_pu": 1.02}, 0.0),  # it has all that it began with
        ({"v_pu": 1.02, "stored_kwh": 2.5 - 0.95 * 36.0 / 3600.0}, 36.0),
        ({"v_pu": 0.96, "gain": 0.0}, 0.0),
    ],
)
def test_what_a_storage_draws(seen, kw):
    np.testing.assert_allclose(draw(**seen), [kw, kw], atol=1e-9)


@pytest.mark.slow
def test_it_holds_the_voltage_and_leaves_clocks_and_reactive_power_to_the_droop():
    s = ieee33_weak_ups(split="validation", horizon=40)
    by_hand, shaved = (rollout(s, law, [1]).series(0) for law in (Droop(), PeakShaving()))
    np.testing.assert_array_equal(shaved.f_mhz[0], by_hand.f_mhz[0])
    assert not by_hand.storage_kw.any()
    assert shaved.storage_kw.min() < -100.0
    outside = [run.metrics()["outside_bus_seconds_pct"] for run in (by_hand, shaved)]
    assert outside[1] < 0.7 * outside[0]


@pytest.mark.slow
def test_it_is_worth_something_and_less_than_hindsight():
    s = ieee33_weak_ups(split="validation")
    shaved, droop = (rollout(s, law, range(4)).costs() for law in (find_controller("peak-shaving", s), Droop()))
    assert shaved.mean() < 0.95 * droop.mean()
    assert 0.95 * shaved[0] > hindsight(s, 0).J


def test_a_batch_that_is_not_in_step_and_agents_apart_are_driven_alike():
    s = toy6_storage()
    law = PeakShaving(v_hold_pu=1.0)
    law.reset(s)
    rng = np.random.default_rng(0)
    width = 7 + 2 + 2 * 7 + 2 * 10
    joint = rng.uniform(0.0, 0.5, (3, width)).astype(np.float32)
    together = law.act(joint)
    assert together.shape == (3, 6)
    assert together[:, 4:].any()
    np.testing.assert_array_equal(together[1], law.act(joint[1]))


def test_it_refuses_a_scenario_without_storages_and_bad_parameters():
    with pytest.raises(ValueError, match="peak-shaving: scenario 'toy6' has no storage; give it devices"):
        PeakShaving().reset(make_scenario("toy6"))
    with pytest.raises(ValueError, match=r"peak-shaving: gain is -1\.0; give a finite"):
        PeakShaving(gain=-1.0)
    with pytest.raises(ValueError, match="peak-shaving: v_hold_pu is nan"):
        PeakShaving(v_hold_pu=float("nan"))
