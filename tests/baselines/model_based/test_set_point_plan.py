"""Set points under which controls take planned positions: the rule of a step, and plans that are replayed."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env import DcgridVectorEnv, ThreePhaseFeeder, acting_relays, action_layout
from dcgrid_env.baselines import ConstantSetPoints, NoControl, rollout
from dcgrid_env.baselines.equipment_agents import at_rest
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.model_based.set_point_plan import bank_set_points, relay_set_points
from helpers.three_phase import ieee13

SET_POINTS = {
    "grid_control.regulators": "setpoint",
    "grid_control.capacitors": "setpoint",
    "grid_control.regulator_settings": {"timer": "integrating"},
}
BY_MINUTES = {"dt_s": 60.0, "background.start_hour": 6.0, "horizon": 30, "inverters.injection": "pv"}


def by_minutes(**overrides):
    return ieee13().replace(**SET_POINTS | BY_MINUTES | overrides)


def relays_of(scenario) -> Any:
    return acting_relays(scenario)


def device_of(scenario, kind):
    return next(device for device in scenario.devices if device.kind == kind)


@given(st.integers(0, 2**32 - 1))
@pytest.mark.slow
def test_regulators_that_may_move_alike_take_the_planned_taps(seed):
    """All regulators of the bank have the same volts, so one band leads all of them."""
    rng, scenario = np.random.default_rng(seed), by_minutes()
    device, relays = device_of(scenario, "regulator_setpoint"), relays_of(scenario)
    steps, n = 12, len(relays.rows)
    taps = np.repeat(rng.integers(-10, 11, steps)[:, None], n, axis=1).astype(float)
    volts = np.repeat(rng.uniform(120.0, 124.0, (steps, 1)), n, axis=1)
    offset_v, half_v = relay_set_points(device, relays, taps[0], taps, volts)
    tap, per_tap = taps[0].copy(), relays.settings.volts_per_tap[relays.rows, relays.rows]
    for step in range(steps):
        target_v = relays.settings.target_v[relays.rows] + offset_v[step, 0] - device.rest_offset_v[0]
        for _ in range(40):  # the rule itself, tap by tap
            off = volts[step] + (tap - taps[step]) * per_tap - target_v
            tap = tap + (off < -half_v[step, 0]) - (off > half_v[step, 0])
        np.testing.assert_array_equal(tap, taps[step])


def test_banks_switch_in_the_planned_steps_although_the_control_waits():
    scenario = by_minutes(**{"grid_control.capacitor_settings": {"delay_s": 100.0}}, horizon=10)
    device = device_of(scenario, "capacitor_setpoint")
    on = np.ones((10, device.count))
    on[4:7, 0] = 0.0
    env = DcgridVectorEnv(1, scenario)
    env.reset(seed=[0])
    layout = action_layout(scenario)
    planned = bank_set_points(device, on, 100.0 / 60.0)
    for step in range(10):
        action = at_rest(scenario)
        for channel, values in zip(device.channels, planned, strict=True):
            share = (values[step] - channel.lowest) / (channel.highest - channel.lowest)
            action[layout.is_channel(channel.name)] = 2.0 * share - 1.0
        env.step(action[None])
        np.testing.assert_array_equal(env.transition.state.bank_on[0], on[step])


@pytest.mark.slow
def test_hindsight_with_set_points_costs_less_than_constant_ones_and_more_than_its_bound():
    scenario = by_minutes(weights={"switching": 1.0})
    found = hindsight(scenario, 0)
    constant = [ConstantSetPoints(offset_v={"reg1": volts}) for volts in (-1.0, -2.0, -3.0)]
    laws = [rollout(scenario, law, [0]).costs()[0] for law in (NoControl(), *constant)]
    assert found.bound < found.J < 0.95 * min(laws)
    equipment = found.recorder.series(0).three_phase.equipment
    moves = equipment.regulators.moves[-1].sum() + equipment.banks.switchings[-1].sum()
    assert moves > 0.0
    pieces = len(relays_of(scenario).rows) + device_of(scenario, "capacitor_setpoint").count
    costs = found.recorder.metrics()[0]
    assert costs["cost_switching"] == pytest.approx(moves / pieces / scenario.horizon)


def test_regulators_under_own_control_beside_set_points_are_not_priced():
    scenario = by_minutes(weights={"switching": 1.0})
    beside = scenario.replace(**{"grid_control.regulators": "controlled"})
    with pytest.raises(ValueError, match=r"prices the moves of agents alone; make all other equipment fixed"):
        hindsight(beside, 0)


def test_steps_that_are_shorter_than_a_delay_are_refused_by_name():
    with pytest.raises(ValueError, match=r"plans set points for steps .* dt_s is 1 and the delay of reg1 longer: give"):
        hindsight(by_minutes(dt_s=1.0), 0)


@pytest.mark.parametrize("mode", ["agent", "setpoint"])
def test_a_switching_in_the_first_step_is_priced(mode):
    """Each switching costs 3 / 2 / 30 of J, about 2 %."""
    settings = {"regulators": "fixed", "capacitors": mode, "capacitor_settings": {"delay_s": 30.0}}
    control = {f"grid_control.{name}": value for name, value in settings.items()}
    found = hindsight(by_minutes(**control, weights={"switching": 3.0}), 0)
    switchings = found.recorder.series(0).three_phase.equipment.banks.switchings.sum(axis=-1)
    assert switchings[1] > 0.0
    assert switchings[1] == switchings[-1]
    assert abs(found.gap) <= 2e-4 * found.J


@pytest.mark.slow
def test_a_delay_beyond_the_episode_switches_nothing():
    scenario = by_minutes(dt_s=1.0, **{"grid_control.regulators": "fixed"})
    found = hindsight(scenario, 0)
    assert found.recorder.series(0).three_phase.equipment.banks.switchings[-1].sum() == 0.0
    assert np.isfinite(found.J)


@pytest.mark.parametrize("tap_delay_s", [0.0, 90.0])
def test_the_bound_allows_a_tap_in_each_step_whatever_the_delay_between_taps(tap_delay_s):
    network = ieee13().feeder.network
    table = replace(network.regulator, tap_delay_s=(tap_delay_s,) * 3)
    feeder = ThreePhaseFeeder.from_network(replace(network, regulator=table))
    found = hindsight(by_minutes(feeder=feeder, horizon=10), 0)
    taps = found.recorder.series(0).three_phase.equipment.regulators.tap
    assert np.abs(np.diff(taps, axis=0)).max() >= 1.0
    assert found.bound <= found.J
