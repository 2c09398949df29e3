"""Timers of regulators: delays worked by hand, both conventions, fixed taps, tensors, and time that adds up."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dcgrid_env import DcgridVectorEnv, ScenarioError, ThreePhaseFeeder, load_feeder, make_scenario
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.devices.tap_changer.regulator_state import initial_regulators
from dcgrid_env.devices.tap_changer.relay import RelayBand, relay_settings, settings_like
from dcgrid_env.devices.tap_changer.timed_taps import next_taps
from dcgrid_env.engine.physics.acting_relays import scenario_relays
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.grid.three_phase_tables import RegulatorTable, SwitchTable
from dcgrid_env.scenario.toml import to_toml

SETTINGS = relay_settings(load_feeder("ieee13-3ph"))
"""122 V, half a band of 1 V, 15 s, then 2 s."""
N = 3
TAP_V = 0.75
NONE_DUE = np.array([[math.inf]])


def band_of(relays, state):
    """The band of the table in every row."""
    return RelayBand(relays.target_v + 0.0 * state.tap, relays.half_band_v + 0.0 * state.tap)


def at_volts(volts, tap=0.0):
    return initial_regulators(np.full((1, N), tap), np.full((1, N), float(volts)))


def tap_times(volts_of_second, integrating, seconds):
    """Times at which the first regulator taps, s; each tap adds 0.75 V to ``volts_of_second``."""
    state, times = at_volts(volts_of_second(0)), []
    for second in range(seconds):
        left = np.array([[1.0]])
        while left[0, 0] > 0.0:
            state = state._replace(relay_v=volts_of_second(second) + TAP_V * state.tap)
            after, passed = next_taps(SETTINGS, state, band_of(SETTINGS, state), left, NONE_DUE, integrating)
            if after.moves[0, 0] > state.moves[0, 0]:
                times.append(second + 1.0 - left[0, 0] + passed[0, 0])
            state, left = after, left - passed
    return times


def dips(*in_band):
    """119.6 V, and 122 V in some seconds."""
    return lambda second: 122.0 if second in in_band else 119.6


def test_the_first_tap_after_the_delay_and_further_ones_after_the_shorter_one():
    assert tap_times(dips(), False, 40) == [15.0, 17.0]  # 119.6 + 2 x 0.75 = 121.1 V is in band


def test_a_second_in_band_restarts_a_timer_that_resets_and_delays_one_that_integrates_by_two():
    assert tap_times(dips(10), False, 40)[0] == 26.0
    assert tap_times(dips(10), True, 40)[0] == 17.0


def test_an_integrating_timer_counts_down_to_zero_and_no_further():
    assert tap_times(dips(*range(3, 30)), True, 60)[0] == 45.0


def test_a_second_in_band_between_two_taps_does_not_end_their_sequence():
    """As in OpenDSS: the drive looks when its tap delay is over."""
    assert tap_times(dips(16), False, 40)[:2] == [15.0, 17.0]
    assert tap_times(dips(17), False, 40)[:2] == [15.0, 33.0]


def test_a_regulator_that_may_make_no_tap_is_fixed():
    network = load_feeder("ieee13-3ph").network
    table = replace(network.regulator, max_taps_per_move=(0, 1, 1))
    feeder = ThreePhaseFeeder.from_network(replace(network, regulator=table))
    state = at_volts(110.0)._replace(tap=feeder.base_tap[None], out_of_band_s=np.full((1, N), 15.0))
    fixed = relay_settings(feeder)
    after, _ = next_taps(fixed, state, band_of(fixed, state), NONE_DUE, NONE_DUE, False)
    assert (after.tap - state.tap).tolist() == [[0.0, 1.0, 1.0]]


def equipment_of(capacitor_settings, **overrides):
    """Equipment of ieee13, whose capacitor banks are controlled, after 20 steps of zero actions."""
    control = {
        "capacitors": "controlled",
        "regulator_settings": {"timer": "reset"},
        "capacitor_settings": capacitor_settings,
    }
    env = DcgridVectorEnv(2, make_scenario("ieee13-3ph", grid_control=control, **overrides))
    env.reset(seed=0)
    for _ in range(20):
        env.step(np.zeros_like(env.action_space.sample()))
    state: Any = env.transition.state
    return state.three_phase.equipment


def test_banks_act_on_a_feeder_without_regulators():
    network = load_feeder("ieee13-3ph").network
    closed = SwitchTable(
        name=(*network.switch.name, "x"), from_bus=(*network.switch.from_bus, "650"),
        to_bus=(*network.switch.to_bus, "rg60"), phases=(*network.switch.phases, "abc"),
        state=(*network.switch.state, "closed"), r_ohm=(*network.switch.r_ohm, 1e-4),
        x_ohm=(*network.switch.x_ohm, 0.0),
    )  # fmt: skip
    feeder = ThreePhaseFeeder.from_network(replace(network, regulator=RegulatorTable(), switch=closed))
    banks = equipment_of({"on_below_pu": 0.8, "off_above_pu": 0.85, "delay_s": 5.0}, feeder=feeder).banks
    assert banks.switchings.tolist() == [[1.0, 1.0]] * 2
    assert (banks.on == 0.0).all()


@pytest.mark.slow
def test_time_passes_beside_a_bank_that_switches_without_end():
    """Without a delay, and with thresholds closer than what the bank does to its voltage."""
    equipment = equipment_of({"on_below_pu": 0.99, "off_above_pu": 0.991, "delay_s": 0.0})
    assert equipment.banks.switchings.max() > 1000
    still = equipment.regulators.moves == 0.0
    np.testing.assert_allclose(equipment.regulators.since_s[still], 20.0)


def test_mpc_refuses_schedules():
    schedule = {"timer": "reset", "offset_v": {"reg1": [[0.0, -2.0]]}}
    day = make_scenario("ieee13-3ph", background={"start_hour": 0.0}, **{"grid_control.regulator_settings": schedule})
    with pytest.raises(ValueError, match=r"plans taps under constant set points; .* give it numbers"):
        rollout(day, make_controller("mpc"), [0])


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_time_passes_once_and_nothing_is_early(data):
    """Over a step of any length: the times passed add up to it, and no regulator taps before its delay."""
    dt_s = data.draw(st.floats(0.5, 90.0))
    volts = np.array([data.draw(st.lists(st.floats(115.0, 129.0), min_size=N, max_size=N))])
    integrating = data.draw(st.booleans())
    state, left, taps = at_volts(122.0)._replace(relay_v=volts), np.array([[dt_s]]), np.zeros(N)
    while left[0, 0] > 0.0:
        after, passed = next_taps(SETTINGS, state, band_of(SETTINGS, state), left, NONE_DUE, integrating)
        turned = after.moves[0] > state.moves[0]
        now = dt_s - left[0, 0] + passed[0, 0]
        assert (now >= np.where(turned, 15.0 + 2.0 * taps, 0.0) - 1e-6).all()
        taps += turned
        state, left = after._replace(relay_v=volts + TAP_V * after.tap), left - passed
    np.testing.assert_allclose(np.where(taps == 0.0, state.since_s[0], dt_s), dt_s, rtol=1e-12)
    assert (state.moves[0] == taps).all()
    assert (taps <= np.maximum(0.0, np.floor((dt_s - 15.0) / 2.0 + 1e-6) + 1.0)).all()


def random_states(n_row):
    rng = np.random.default_rng(0)
    shape = (n_row, N)
    tap, volts = rng.integers(-16, 17, shape).astype(float), rng.normal(122.0, 2.0, shape)
    waited = rng.uniform(0.0, 20.0, shape)
    state = initial_regulators(tap, volts)._replace(out_of_band_s=waited, in_sequence=(waited < 2.0) * 1.0)
    left, due = rng.choice([0.0, 1.0, 60.0], (n_row, 1)), rng.choice([0.3, 20.0, math.inf], (n_row, 1))
    return state, left, due


@pytest.mark.parametrize("integrating", [False, True])
def test_rows_and_tensors_have_the_same_bits(integrating):
    state, left, due = random_states(64)
    together = next_taps(SETTINGS, state, band_of(SETTINGS, state), left, due, integrating)
    for row in (0, 17, 63):
        one = type(state)(*(a[row : row + 1] for a in state))
        alone = next_taps(SETTINGS, one, band_of(SETTINGS, one), left[row : row + 1], due[row : row + 1], integrating)
        for of_row, of_all in zip(alone.state, together.state, strict=True):
            np.testing.assert_array_equal(of_row[0], of_all[row])
    tensors = type(state)(*map(torch.from_numpy, state))
    given_left, given_due = torch.from_numpy(left), torch.from_numpy(due)
    relays = settings_like(SETTINGS, tensors.tap)
    on_tensors = next_taps(relays, tensors, band_of(relays, tensors), given_left, given_due, integrating)
    for of_tensor, of_array in zip((*on_tensors.state, on_tensors[1]), (*together.state, together[1]), strict=True):
        np.testing.assert_array_equal(of_tensor.numpy(), of_array)


def ieee123(**control):
    return make_scenario("ieee123-3ph", **{"grid_control.regulator_settings": control})


def test_offsets_of_banks_move_what_their_relays_hold():
    shifted = ieee123(timer="integrating", offset_v={"reg4": -4.0, "creg4b": -4.2})
    table, before = shifted.feeder.network.regulator, relay_settings(shifted.feeder)
    offset_v = [-4.2 if name == "creg4b" else -4.0 if name.startswith("creg4") else 0.0 for name in table.name]
    expected = before.target_v + np.array(offset_v)
    np.testing.assert_array_equal(scenario_relays(shifted).target_v, expected)
    state: Any = Simulation(shifted, 1).reset([0]).state
    np.testing.assert_allclose(
        state.three_phase.equipment.regulators.relay_v[0], expected, rtol=0.0, atol=before.half_band_v.max()
    )


@pytest.mark.parametrize(
    ("control", "message"),
    [
        ({"timer": "fast"}, "regulator_settings.timer is 'fast'; choose one of reset, integrating"),
        ({"offset_v": 40.0}, "regulator_settings.offset_v is 40.0; give volts between -12 and 12"),
        ({"offset_v": {"reg4": True}}, "give volts between -12 and 12, or a mapping from banks or regulators to these"),
        ({"offset_v": {"creg9": 1.0}}, "has no bank or regulator 'creg9'; there are reg1a, reg2, reg3, reg4"),
        ({"offset_v": [["reg4", 1.0], ["reg4", 2.0]]}, "or a mapping from banks or regulators to these"),
        ({"offset_v": [[{"a": 1}, 2.0]]}, "or a mapping from banks or regulators to these"),
        ({"offset": 1.0}, "grid_control.regulator_settings.offset is no field; did you mean offset_v"),
    ],
)
def test_what_cannot_be_set_is_refused_by_name(control, message):
    with pytest.raises(ScenarioError) as error:
        ieee123(**control)
    assert message in str(error.value)


def test_offsets_of_a_balanced_feeder_are_refused():
    with pytest.raises(ScenarioError, match="has no bank or regulator 'creg1'; there are none"):
        make_scenario("ieee33", **{"grid_control.regulator_settings": {"offset_v": {"creg1": 1.0}}})


def test_timers_of_a_balanced_feeder_are_refused():
    with pytest.raises(ScenarioError, match="the balanced feeder 'ieee33' has no regulators that act; leave it out"):
        make_scenario("ieee33", **{"grid_control.regulator_settings": {"timer": "reset"}})


def test_a_file_holds_timers_and_offsets(tmp_path):
    scenario = ieee123(timer="reset", offset_v={"reg4": -4.0, "creg1a": 0.5})
    path = tmp_path / "scenario.toml"
    to_toml(scenario, path)
    assert make_scenario(path).grid_control == scenario.grid_control
