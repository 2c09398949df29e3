"""tap trajectories: the plan of one relay is the best of all, and controls led by its demands follow it."""

from itertools import product
from typing import Any

import numpy as np
import pytest

from dcgrid_env import acting_relays, make_scenario
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.model_based.tap_search import _Costs, _Plan
from dcgrid_env.baselines.model_based.tap_trajectory import MARGIN_V, TapTrajectory
from dcgrid_env.devices.tap_changer.regulator_state import initial_regulators
from dcgrid_env.devices.tap_changer.relay import RelayBand
from dcgrid_env.devices.tap_changer.timed_taps import next_taps
from helpers.three_phase import ieee13

TIMERS = ("integrating", "reset")


def _costs(rng, steps, positions):
    """Costs of random demands; the ends of the range cannot be left."""
    anywhere, further = rng.uniform(1.0, 2.0, (steps, positions)), rng.uniform(0.0, 1.0, (4, steps, positions))
    in_band, out_of_band, up, down = further + anywhere
    up[:, -1] = down[:, 0] = np.inf
    return _Costs(anywhere, in_band, out_of_band, rng.choice([-1.0, 1.0], anywhere.shape), up, down)


def _cost_of(costs, does, at, delays, back, price):
    """Cost of one trajectory of a relay, given what it does in each step; infinite for one that its rule excludes."""
    (delay, further), timer, within, total = delays, 0, False, 0.0
    for t, what in enumerate(does):
        due = timer >= (further if within else delay)
        if what == "wait":
            if due or not within:
                return np.inf
            total, timer = total + costs.anywhere[t, at], timer + 1
        elif what == "out":
            if due or within:
                return np.inf
            total, timer = total + costs.out_of_band[t, at], timer + 1
        elif what == "hold":
            if within and not due:
                return np.inf
            total += costs.in_band[t, at]
            timer, within = 0 if within else max(timer - back, 0), False
        else:
            if not due:
                return np.inf
            total += (costs.up if what == "up" else costs.down)[t, at] + price
            at, timer, within = at + (1 if what == "up" else -1), 1, True
            if not np.isfinite(total):
                return np.inf
    return total


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("timer", TIMERS)
def test_the_plan_of_a_relay_is_the_best_of_all_courses(timer, seed):
    rng, delays, price = np.random.default_rng(seed), ((2, 1), (3, 2))[seed % 2], 0.3 * (seed % 3)
    costs = _costs(rng, 6, 3)
    back = 1 if timer == "integrating" else delays[0]
    plan = _Plan(costs, delays, timer == "integrating", price)
    every = product(("wait", "out", "hold", "up", "down"), repeat=6)
    least = min(_cost_of(costs, does, 1, delays, back, price) for does in every)
    assert plan.cost(1) == pytest.approx(least, rel=1e-12)


def _followed(scenario, relays, before, after, tap):
    """Taps at t = 0 and after each step, (1 + T, R), with these relay volts before and after the taps of each step."""
    settings: Any = relays.settings
    band, none_due = RelayBand(settings.target_v[None], settings.half_band_v[None]), np.full((1, 1), np.inf)
    is_integrating = scenario.grid_control.regulator_settings.timer == "integrating"
    state, found = initial_regulators(tap[None], settings.target_v[None]), [tap]
    for first_v, then_v in zip(before, after, strict=True):
        left_s, volts = np.full((1, 1), scenario.dt_s), first_v
        while left_s[0, 0] > 0.0:
            measured = state._replace(relay_v=volts[None])
            state, passed_s = next_taps(settings, measured, band, left_s, none_due, is_integrating)
            left_s, volts = left_s - passed_s, then_v
        found.append(state.tap[0])
    return np.array(found)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("timer", TIMERS)
def test_controls_that_measure_what_is_demanded_follow_the_course(timer, seed):
    scenario = ieee13().replace(grid_control={"regulator_settings": {"timer": timer}}, horizon=80)
    relays = acting_relays(scenario)
    assert relays is not None
    rng = np.random.default_rng(seed)
    plans = [
        _Plan(_costs(rng, 80, 5), (int(delay), int(further)), timer == "integrating", 0.0).follow(2)
        for delay, further in zip(relays.steps, relays.further_steps, strict=True)
    ]
    tap, side, due = (np.stack(parts, axis=1) for parts in zip(*plans, strict=True))
    trajectory = TapTrajectory(tap + 6.0, side, due)
    assert np.abs(trajectory.moves).sum() > 0.0
    effect = 0.75 * trajectory.moves
    low, high = trajectory.demands(relays, effect)
    anything = relays.settings.target_v[relays.rows] + rng.uniform(-4.0, 4.0, low.shape)
    after = np.clip(anything, low + MARGIN_V, high - MARGIN_V)
    np.testing.assert_array_equal(_followed(scenario, relays, after - effect, after, trajectory.tap[0]), trajectory.tap)


def _short(price):
    offset_v = {"reg1": -2.4, "reg2": -5.7, "reg3": -1.7}
    return make_scenario(
        "ieee13-3ph",
        horizon=40,
        weights={"switching": price},
        **{"grid_control.regulator_settings": {"timer": "integrating", "offset_v": offset_v}},
    )


@pytest.mark.parametrize("price", [0.0, 10.0])
@pytest.mark.slow
def test_hindsight_leads_the_taps_of_controls_that_act_within_steps(price):
    scenario = _short(price)
    found = hindsight(scenario, 0)
    j = {name: _cost(scenario, name) for name in ("none", "mpc")}
    assert found.bound < found.J < min(j.values())
    metrics = found.recorder.metrics()[0]
    assert metrics["J"] == found.J
    assert (metrics["tap_moves"] > 2) == (price == 0.0)


def _cost(scenario, name):
    controller = make_controller(name)
    return rollout(scenario.replace(observe="feeder"), controller, [0]).metrics()[0]["J"]


def test_a_price_on_switching_is_for_taps_alone():
    with pytest.raises(ValueError, match="prices the taps of built-in controls alone; make all other equipment fixed"):
        hindsight(_short(1.0).replace(grid_control={"capacitors": "controlled"}), 0)
    with pytest.raises(ValueError, match="hindsight does not price switching"):
        hindsight(ieee13().replace(weights={"switching": 1.0}, grid_control={"regulators": "fixed"}), 0)
