"""Agents that choose set points: when these are taken over, what controls do, what is charged and observed."""

from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

from dcgrid_env import DcgridEnv, TensorEnv, make_scenario, parallel_env, under_own_control
from dcgrid_env.baselines import make_controller, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.engine.cost import observation
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.physics.state import over_arrays
from dcgrid_env.engine.record.episode_record import Recorder
from dcgrid_env.engine.simulation import Simulation
from helpers.three_phase import ieee13, ieee123

QUIET = {
    "datacenters.p_rated_kw": 1.0,
    "trace": "step",
    "workload.window": "start",
    "background.load_sigma": 0.0,
    "horizon": 90,
}
"""Constant loads: only set points move anything. The relays are at 122.14, 122.59 and 122.86 V at t = 0."""
RESET = {"timer": "reset"}


def regulated(timer="reset", **overrides) -> Any:
    """One bank of three regulators with a target of 122 V, half a band of 1 V, and delays of 15 s and 2 s."""
    settings = {"timer": timer} | overrides.pop("settings", {})
    modes = {"grid_control.regulators": "setpoint", "grid_control.regulator_settings": settings}
    return ieee13().replace(**QUIET | modes | overrides)


def switched(**overrides) -> Any:
    """Both capacitor banks under thresholds of agents, regulators fixed; 10 s beyond a threshold switch."""
    modes = {
        "grid_control.regulators": "fixed",
        "grid_control.capacitors": "setpoint",
        "grid_control.capacitor_settings": {"delay_s": 10.0},
        "grid_control.regulator_settings": RESET,
    }
    return ieee13().replace(**QUIET | modes | overrides)


def requested(scenario, **setpoints: Any):
    """The joint action that requests set points in their units; every other channel keeps its default."""
    parts = []
    for device in scenario.devices:
        columns = []
        for channel in device.channels:
            asked = setpoints.get(channel.name, channel.rest)
            columns.append(2.0 * (asked - channel.lowest) / (channel.highest - channel.lowest) - 1.0)
        parts.append(np.stack([np.zeros(device.count) + column for column in columns], axis=-1).ravel())
    return np.concatenate(parts)


def play(scenario, steps, *actions: Any) -> Any:
    """Transitions of environments, each under an action or a function of the step that begins, from the reset on."""
    simulation = Simulation(scenario, len(actions))
    transitions = [simulation.reset([0] * len(actions))]
    for k in range(steps):
        joint: list[Any] = [a(k) if callable(a) else a for a in actions]
        transitions.append(simulation.step(np.stack(joint)))
    return transitions


def regulators(transition) -> Any:
    return transition.state.three_phase.equipment.regulators


def moves(transitions, env_index=0):
    """Step in whose interval a tap was made, and the taps after it."""
    taps = np.array([regulators(t).tap[env_index] for t in transitions])
    return {int(k): taps[k].tolist() for k in np.flatnonzero(np.diff(taps, axis=0).any(1)) + 1}


RAISED = {16: [11.0, 9.0, 12.0], 18: [12.0, 10.0, 13.0], 20: [13.0, 10.0, 13.0]}
"""124 V is the least under an offset of 3 V, and a tap is 0.79 V: three of phase a, two of the others. The first is
made 15 s after the request, in the interval of step 16, and each further one 2 s later."""
LOWERED = {76: [12.0, 9.0, 12.0], 78: [11.0, 8.0, 11.0]}


@pytest.mark.parametrize("timer", ["reset", "integrating"])
def test_taps_follow_a_set_point_after_the_delays_of_the_control(timer):
    scenario = regulated(timer)
    up = requested(scenario, offset=3.0)
    transitions = play(scenario, 30, up, requested(scenario))
    assert regulators(transitions[0]).tap[0].tolist() == [10.0, 8.0, 11.0]
    assert moves(transitions) == RAISED
    assert moves(transitions, 1) == {}


def test_a_request_waits_until_the_set_point_has_been_in_force_for_its_time():
    """The request of second 0 is taken over, that of second 21 to return is ignored until second 60."""
    scenario = regulated()
    up, rest = requested(scenario, offset=3.0), requested(scenario)
    transitions = play(scenario, 90, lambda k: up if k < 21 else rest)
    offsets = [t.state.devices[-1].offset_v.item() for t in transitions]
    assert offsets == [0.0] + [3.0] * 60 + [0.0] * 30
    assert moves(transitions) == RAISED | LOWERED


def test_a_longer_time_is_kept():
    scenario = regulated(settings={"hold_s": 70.0})
    transitions = play(scenario, 90, lambda k: requested(scenario, offset=0.05 * k))
    changes = np.flatnonzero(np.diff([t.state.devices[-1].offset_v.item() for t in transitions])) + 1
    assert changes.tolist() == [2, 72]
    np.testing.assert_allclose(transitions[-1].state.devices[-1].offset_v, 0.05 * 71)


def test_a_narrower_band_moves_those_that_are_out_of_it():
    """122.14 V is within 0.4 V of 122 V; of the others each is brought there by a tap down."""
    scenario = regulated()
    transitions = play(scenario, 30, requested(scenario, half_band=0.4))
    assert moves(transitions) == {16: [10.0, 7.0, 10.0]}


def test_a_step_of_a_minute_makes_the_same_taps_at_the_same_seconds():
    scenario = regulated(dt_s=60.0, horizon=4)
    up, rest = requested(scenario, offset=3.0), requested(scenario)
    transitions = play(scenario, 3, lambda k: rest if k == 1 else up)
    assert moves(transitions) == {1: [13.0, 10.0, 13.0], 2: [11.0, 8.0, 11.0], 3: [13.0, 10.0, 13.0]}
    state = transitions[1].state.devices[-1]
    assert (state.moved.item(), state.setpoint_age_s.item()) == (7.0, 60.0)
    np.testing.assert_array_equal(regulators(transitions[1]).since_s, [[41.0, 43.0, 43.0]])


def test_an_episode_begins_settled_at_the_set_points_at_rest():
    scenario = regulated(settings={"offset_v": {"reg1": 3.0}})
    (bank,) = scenario.devices[-1:]
    assert [channel.rest.tolist() for channel in bank.channels] == [[3.0], [1.0]]
    first = play(scenario, 30, requested(scenario))
    assert regulators(first[0]).tap[0].tolist() == RAISED[20]
    assert moves(first) == {}
    far = regulated(settings={"offset_v": -6.0}).devices[-1].channels[0]
    assert (far.lowest.item(), far.highest.item(), far.rest.item()) == (-6.0, 4.0, -6.0)


def test_what_an_agent_observes():
    scenario = regulated()
    names = observation.field_names(scenario)
    at = sum(len(names[agent]) for agent in scenario.agents[:-1]) - len(names["regset_0"])
    transitions = play(scenario, 30, requested(scenario, offset=3.0, half_band=1.5))
    seen = [
        dict(zip(names["regset_0"], t.observation[0, at + len(names["regset_0"]) :], strict=True)) for t in transitions
    ]
    relay_v = regulators(transitions[16]).relay_v.mean()
    found = [seen[16][name] for name in ("mean_tap", "offset", "half_band", "since_change", "mean_relay")]
    off = (relay_v - 125.0) / 122.0 / scenario.cost.band_pu
    np.testing.assert_allclose(found, [(11 + 9 + 12) / 3 / 16, 0.75, 0.5, 16.0 / 60.0, off], atol=1e-5)
    assert seen[0]["since_change"] == 1.0
    low, high = observation.bounds(scenario)["regset_0"]
    assert all((low <= list(one.values())).all() and (list(one.values()) <= high).all() for one in seen)


def test_a_bank_of_each_mode_on_one_feeder():
    modes = {"reg1a": "controlled", "reg2": "fixed", "reg3": "agent", "reg4": "setpoint"}
    scenario: Any = ieee123().replace(
        **QUIET, grid_control={"regulators": modes, "regulator_settings": RESET}, source_voltage_pu=1.02
    )
    assert scenario.agents[-3:] == ("reg_0", "reg_1", "regset_0")
    table = scenario.feeder.network.regulator
    asked = requested(scenario, offset=4.0, tap=scenario.devices[-2].parameters.base + 2.0)
    transitions = play(scenario, 60, asked, requested(scenario))
    change = np.diff([regulators(t).tap for t in (transitions[0], transitions[-1])], axis=0)[0]
    by_bank = {bank: change[:, [b == bank for b in table.bank]] for bank in modes}
    assert (by_bank["reg2"] == 0.0).all()
    assert by_bank["reg3"].tolist() == [[2.0, 2.0], [0.0, 0.0]]
    assert (by_bank["reg4"][0] >= 4.0).all()
    assert (by_bank["reg4"][1] == 0.0).all()


def test_each_row_is_as_it_would_be_alone():
    scenario = regulated()
    asked = [requested(scenario, offset=offset) for offset in (-4.0, 0.0, 1.5, 4.0)]
    together = play(scenario, 40, *asked)[-1].state
    assert len(np.unique(together.three_phase.equipment.regulators.tap[:, 0])) == 4
    for row, action in enumerate(asked):
        alone = play(scenario, 40, action)[-1].state

        def same_bits(one, many, row=row):
            if one.ndim and len(one) == 1:
                np.testing.assert_array_equal(one[0], many[row])
            return one

        over_arrays(same_bits, alone, together)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_tensors_take_the_same_steps(dtype):
    scenario = regulated(**{
        "grid_control.capacitors": "setpoint",
        "grid_control.capacitor_settings": {"delay_s": 10.0},
    })  # fmt: skip
    asked = np.stack([requested(scenario, offset=3.0, centre=0.95, half_width=0.01), requested(scenario)])
    ours = play(scenario, 45, *asked)[-1]
    env: Any = TensorEnv(scenario, like=torch.zeros(1, dtype=dtype))
    env.reset([0, 0])
    *_, step = (env.step(torch.tensor(asked, dtype=dtype)) for _ in range(45))
    (mine, my_banks), (theirs, banks) = ours.state.three_phase.equipment, env.state.three_phase.equipment
    np.testing.assert_array_equal(theirs.tap.numpy(), mine.tap)
    np.testing.assert_array_equal(banks.on.numpy(), my_banks.on)
    assert mine.moves[0].sum() >= 7.0
    assert my_banks.switchings[0].sum() >= 1.0
    np.testing.assert_allclose(step.observation.numpy(), ours.observation, atol=1e-4)


def test_the_offset_observed_has_the_derivative_of_the_request():
    scenario = regulated()
    joint = torch.tensor(requested(scenario, offset=1.0)[None], requires_grad=True)
    env: Any = TensorEnv(scenario, like=torch.zeros(1, dtype=torch.float64))
    env.reset([0])
    env.step(joint).state.devices[-1].offset_v.sum().backward()
    assert joint.grad is not None
    assert joint.grad[0, torch.tensor(action_layout(scenario).is_channel("offset"))].item() == 4.0


def test_taps_under_a_set_point_are_charged_to_the_team_and_to_its_agent():
    """Three regulators are not fixed, so a tap costs the team a third of the weight; the agent pays it whole."""
    priced = regulated(weights={"switching": 2.0})
    up = requested(priced, offset=3.0)
    charged = [t.costs.switching.item() for t in play(priced, 20, up)]
    np.testing.assert_allclose([charged[k] for k in (15, 16, 18, 20)], [0.0, 2.0, 2.0, 2.0 / 3.0])
    own, free = (play(s.replace(reward="local"), 16, up)[-1].reward for s in (priced, regulated()))
    np.testing.assert_allclose((free - own)[0], [0.0] * 6 + [6.0], atol=1e-9)


def test_metrics_count_the_taps():
    scenario = regulated(horizon=20)
    transitions = play(scenario, 20, requested(scenario, offset=3.0))
    recorder = Recorder(scenario, transitions[0])
    for transition in transitions[1:]:
        recorder.add(transition)
    assert recorder.metrics()[0]["tap_moves"] == 7.0


def test_a_bank_of_capacitors_switches_by_the_thresholds_of_its_agent():
    """Above 0.96 p.u. a bank is switched off after 10 s; by the default thresholds it is switched on below 0.98 p.u."""
    scenario = switched()
    low, rest = requested(scenario, centre=[0.95, 1.01], half_width=[0.01, 0.03]), requested(scenario)
    transitions = play(scenario, 80, lambda k: low if k < 20 else rest, rest)
    on = np.array([t.state.three_phase.equipment.banks.on for t in transitions])
    v_pu = transitions[60].state.three_phase.equipment.banks.v_pu
    assert (on[:, 1] == 1.0).all()
    assert (on[:, 0, 1] == 1.0).all()
    assert np.flatnonzero(np.diff(on[:, 0, 0])).tolist()[0] + 1 == 11
    assert v_pu[0, 0] > 0.96
    low_pu, high_pu = (
        transitions[60].state.devices[-1].centre_pu[0] + sign * transitions[60].state.devices[-1].half_width_pu[0]
        for sign in (-1.0, 1.0)
    )
    np.testing.assert_allclose([low_pu, high_pu], [[0.94, 0.98], [0.96, 1.04]])
    centres = [t.state.devices[-1].centre_pu[0, 0] for t in transitions]
    np.testing.assert_allclose(centres, [1.01] + [0.95] * 60 + [1.01] * 20)
    assert transitions[11].state.devices[-1].switched.tolist() == [[1.0, 0.0], [0.0, 0.0]]


def test_the_measurement_of_a_capacitor_bank_is_observed_against_its_centre():
    scenario = switched()
    names = observation.field_names(scenario)
    last = play(scenario, 5, requested(scenario, centre=0.97, half_width=0.05))[-1]
    seen = dict(zip(names["capset_1"], last.observation[0, -len(names["capset_1"]) :], strict=True))
    v_pu, band = last.state.three_phase.equipment.banks.v_pu[0, 1], scenario.cost.band_pu
    expected = [1.0, -0.03 / band, 1.0, 5.0 / 60.0, (v_pu - 0.97) / band]
    found = [seen[name] for name in ("on", "centre", "half_width", "since_change", "bank_voltage")]
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("name", ["none", "droop-q", "mpc"])
def test_controllers_of_the_other_agents_leave_set_points_at_rest(name):
    scenario = regulated(**{"grid_control.capacitors": "setpoint", "background.load_sigma": 0.1, "horizon": 30})
    alone = under_own_control(scenario)
    assert (alone.grid_control.regulators, alone.grid_control.capacitors) == ("controlled", "controlled")
    with_agents, without = (rollout(s, make_controller(name, s), [0]).metrics()[0] for s in (scenario, alone))
    assert with_agents["J"] == without["J"]


def test_hindsight_refuses_schedules():
    settings = RESET | {"offset_v": {"reg1": [[6.0, 1.0]]}}
    scheduled = ieee13().replace(grid_control={"regulator_settings": settings}, background={"start_hour": 0.0})
    with pytest.raises(ValueError, match=r"hindsight plans taps under constant set points; .*offset_v"):
        hindsight(scheduled, 0)


def test_tuned_gains_apply_under_set_points():
    scenario = make_scenario(
        "ieee13-3ph", **{"grid_control.regulators": "setpoint", "grid_control.regulator_settings": RESET}
    )
    (metrics,) = rollout(scenario.replace(horizon=5), make_controller("droop-tuned", scenario), [0]).metrics()
    assert np.isfinite(metrics["J"])


@pytest.mark.parametrize("make", [regulated, switched])
def test_environments_pass_the_checks_of_their_interfaces(make):
    scenario = make(horizon=10)
    check_env(DcgridEnv(scenario), skip_render_check=True)
    parallel_api_test(parallel_env(scenario), num_cycles=30)
