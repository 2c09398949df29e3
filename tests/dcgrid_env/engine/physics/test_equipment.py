"""Regulators and capacitor banks over an episode: settled, controlled, commanded by agents, charged and shown."""

from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env import CostWeights, DcgridVectorEnv, Fault, TensorEnv, parallel_env
from dcgrid_env.devices.tap_changer.relay import direction, relay_settings, relay_volts
from dcgrid_env.engine.cost import observation, reward
from dcgrid_env.engine.exogenous import episode
from dcgrid_env.engine.physics import dynamics
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.physics.state import over_arrays
from dcgrid_env.engine.record.episode_record import Recorder
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.powerflow import Control, solve_unbalanced
from helpers.three_phase import SCENARIOS, ieee13

HEAVY = {
    "datacenters.p_rated_kw": 1500.0,
    "trace": "step",
    "workload.window": "start",
    "background.load_sigma": 0.0,
    "horizon": 60,
}
"""Two sites that draw some 2.3 MW more from second 20 on, so that regulators have to move."""
AGENTS = {"grid_control.regulators": "agent", "grid_control.capacitors": "agent"}


def play(scenario, n_env=2, steps=None, action=None) -> Any:
    """The transitions of a batch from the reset on, under the same joint action in every step."""
    simulation = Simulation(scenario, n_env)
    transitions = [simulation.reset(list(range(n_env)))]
    joint = np.zeros(action_layout(scenario).n) if action is None else action
    for _ in range(steps or scenario.horizon):
        transitions.append(simulation.step(np.tile(joint, (n_env, 1))))
    return transitions


def taps_of(transitions, env_index=0):
    return np.array([t.state.three_phase.equipment.regulators.tap[env_index] for t in transitions])


def commanded(scenario, **channels):
    """The joint action with every clock at its top and some channels set."""
    layout = action_layout(scenario)
    joint = layout.is_channel("clock").astype(float)
    for name, value in channels.items():
        joint[layout.is_channel(name)] = value
    return joint


@pytest.mark.parametrize("name", SCENARIOS)
def test_an_episode_begins_in_band_and_every_environment_as_it_would_alone(name):
    scenario = SCENARIOS[name]().replace(background={"start_hour": "random"})
    together: Any = Simulation(scenario, 6).reset(list(range(6))).state
    regulators = together.three_phase.equipment.regulators
    assert (direction(relay_settings(scenario.feeder), regulators.relay_v, regulators.tap) == 0.0).all()
    for env_index in (0, 5):
        alone = Simulation(scenario, 1).reset([env_index]).state

        def same_bits(one, many, env_index=env_index):
            np.testing.assert_array_equal(one[0], many[env_index])
            return one

        over_arrays(same_bits, alone, together)


def test_controls_act_on_the_power_flow_of_the_step_before():
    scenario = ieee13().replace(**HEAVY)
    feeder, transitions = scenario.feeder, play(ieee13().replace(**HEAVY), n_env=1, action=None)
    taps, settings = taps_of(transitions), relay_settings(feeder)
    out = [
        direction(settings, t.state.three_phase.equipment.regulators.relay_v, taps[k])[0].any()
        for k, t in enumerate(transitions)
    ]
    first_out, first_move = out.index(True), int(np.flatnonzero(np.diff(taps, axis=0).any(1))[0]) + 1
    assert first_move - first_out == 15
    moved = np.flatnonzero(np.diff(taps, axis=0).any(1)) + 1
    assert set(np.diff(moved)) == {2}
    assert np.abs(np.diff(taps, axis=0)).max() == 1.0
    last, drawn = transitions[-1].state, episode.draw(scenario, np.zeros(1, np.uint64), np.zeros(1, np.uint64))
    *_, (_, outside) = episode.unroll(scenario, drawn)
    p_kw, q_kvar = dynamics.net_loads(outside.p_load_kw, outside.q_load_kvar, outside.legs, last.p_kw, last.q_kvar)
    again = solve_unbalanced(feeder, p_kw, q_kvar, scenario.source_voltage_pu, Control(feeder.tap_ratio(taps[-1])))
    np.testing.assert_allclose(again.v_pu, last.v_pu, atol=1e-7)
    np.testing.assert_allclose(relay_volts(settings, again), last.three_phase.equipment.regulators.relay_v, atol=1e-4)


def test_fixed_regulators_stay_and_metrics_and_info_count_what_moves():
    fixed, controlled = (
        ieee13().replace(**HEAVY, **{"grid_control.regulators": who}) for who in ("fixed", "controlled")
    )
    base = fixed.feeder.base_tap
    assert (taps_of(play(fixed)) == base).all()
    transitions = play(controlled)
    recorder = Recorder(controlled, transitions[0])
    for transition in transitions[1:]:
        recorder.add(transition)
    taps = taps_of(transitions, 1)
    metrics = recorder.metrics()[1]
    assert metrics["tap_moves"] == np.abs(np.diff(taps, axis=0)).sum() >= 3.0
    assert metrics["capacitor_switchings"] == 0.0
    regulators = transitions[-1].state.three_phase.equipment.regulators
    np.testing.assert_array_equal(regulators.moves.sum(-1)[1], metrics["tap_moves"])


def test_moves_and_positions_stand_in_info():
    scenario = ieee13().replace(**AGENTS)
    env = parallel_env(scenario)
    env.reset(seed=0)
    actions = {agent: np.ones(env.action_space(agent).shape or (), np.float32) for agent in env.agents}
    actions["cap_1"] = -actions["cap_1"]
    *_, infos = env.step(actions)
    info = infos["dc_0"]
    taps = scenario.feeder.base_tap + 1.0
    assert [info[f"tap_{name}"] for name in ("reg1", "reg2", "reg3")] == taps.tolist()
    assert (info["tap_moves"], info["capacitor_switchings"]) == (3.0, 1.0)
    assert (info["capacitor_cap1"], info["capacitor_cap2"]) == (1.0, 0.0)


def test_agents_move_regulators_and_banks_and_see_where_they_stand():
    scenario = ieee13().replace(**AGENTS, horizon=30)
    assert scenario.agents[-5:] == ("reg_0", "reg_1", "reg_2", "cap_0", "cap_1")
    transitions = play(scenario, action=commanded(scenario, tap=[-1.0, 0.0, 0.26], on=[-1.0, 1.0]))
    taps, last = taps_of(transitions), transitions[-1]
    assert taps[-1].tolist() == [
        -6.0,
        0.0,
        4.0,
    ]  # 16 taps within 30 s down from 10, a tap each 2 s, and all that was asked for
    assert np.abs(np.diff(taps, axis=0)).max() == 1.0
    assert last.state.three_phase.equipment.banks.on[0].tolist() == [0.0, 1.0]
    names = observation.field_names(scenario)
    joint = iter(last.observation[0].tolist())
    seen = {agent: {name: next(joint) for name in fields} for agent, fields in names.items()}
    assert seen["reg_0"]["tap"] == pytest.approx(-6.0 / 16.0)
    assert seen["reg_2"]["tap"] == pytest.approx(4.0 / 16.0)
    assert seen["cap_0"]["on"] == 0.0
    assert seen["cap_0"]["since_switching"] == pytest.approx(29.0 / 30.0)
    bus = list(scenario.feeder.nodes_of("rg60", "b"))
    deviation = (last.state.v_pu[0, bus[0]] - 1.0) / scenario.cost.band_pu
    assert seen["reg_1"]["v_deviation"] == pytest.approx(deviation, abs=1e-5)
    assert (last.state.p_kw[:, -5:] == 0.0).all()
    assert (last.state.q_limit_kvar[:, -5:] == 0.0).all()


def test_one_bank_is_an_agent_and_another_controlled():
    scenario = SCENARIOS["ieee123"]().replace(grid_control={"regulators": {"reg4": "agent", "reg2": "fixed"}})
    names, rows = scenario.feeder.network.regulator.name, scenario.devices[-1].rows
    assert [names[row] for row in rows] == ["creg4a", "creg4b", "creg4c"]
    transitions = play(scenario, n_env=1, steps=6, action=commanded(scenario, tap=1.0))
    risen = dict(zip(names, taps_of(transitions)[-1] - taps_of(transitions)[0], strict=True))
    assert [risen[name] for name in ("creg4a", "creg4b", "creg4c", "creg2a")] == [4.0, 4.0, 4.0, 0.0]


def test_a_controlled_bank_switches_itself_and_a_lost_one_stays_off():
    settings = {"measures": "voltage", "on_below_pu": 0.6, "off_above_pu": 0.9, "delay_s": 3.0}
    scenario = ieee13().replace(
        grid_control={"capacitors": {"cap1": "controlled"}, "capacitor_settings": settings}, horizon=10
    )
    on = [t.state.three_phase.equipment.banks.on[0].tolist() for t in play(scenario, n_env=1)]
    assert on == [[1.0, 1.0]] * 4 + [[0.0, 1.0]] * 7
    struck = ieee13().replace(
        faults=(Fault(("capacitor",), begin_s=(0.0, 0.0)),), grid_control={"capacitors": "agent"}, horizon=4
    )
    kept = ieee13().replace(grid_control={"capacitors": "agent"}, horizon=4)
    high, low = (play(s, n_env=1, action=commanded(s, on=1.0))[-1] for s in (kept, struck))
    assert low.state.three_phase.equipment.banks.on.tolist() == [[1.0, 1.0]]
    assert low.state.v_pu.mean() < high.state.v_pu.mean() - 1e-4


def test_switching_is_charged_to_the_team_and_to_who_moves():
    weights = CostWeights(switching=2.0)
    scenario = ieee13().replace(
        grid_control={"regulators": "agent", "capacitors": {"cap2": "agent"}}, cost={"weights": weights}
    )
    action = commanded(scenario, tap=[1.0, 0.5, 11.0 / 16.0], on=[-1.0])
    first = play(scenario, steps=1, action=action)[1]
    np.testing.assert_allclose(first.costs.switching, 2.0 * 2.0 / 4.0)  # reg1 up, cap2 off; reg2 and reg3 stay; of four
    own = play(scenario.replace(reward="local"), steps=1, action=action)[1]
    free = play(scenario.replace(reward="local", cost={"weights": CostWeights()}), steps=1, action=action)[1]
    np.testing.assert_allclose((free.reward - own.reward)[0, -4:], [2.0, 0.0, 0.0, 2.0], atol=1e-9)
    assert reward.largest_costs(scenario)._asdict()["switching"] == 2.0 * 97 / 4


def test_controlled_moves_are_charged_to_all_alike():
    scenario = ieee13().replace(**HEAVY, cost={"weights": {"switching": 1.0}})
    charged = np.array([t.costs.switching[0] for t in play(scenario)])
    moved = np.array([t.state.three_phase.equipment.regulators.moved[0].sum() for t in play(scenario)])
    np.testing.assert_allclose(charged[1:], moved[1:] / 3.0)
    assert charged.sum() >= 1.0


def test_effort_is_a_mean_over_agents_with_a_converter():
    plain, with_agents = ieee13(), ieee13().replace(**AGENTS)
    action, more = commanded(plain, q=0.5), commanded(with_agents, q=0.5, tap=0.0, on=1.0)
    a, b = (play(s, steps=1, action=joint)[1] for s, joint in ((plain, action), (with_agents, more)))
    np.testing.assert_allclose(a.costs.effort, b.costs.effort, rtol=1e-9)


@pytest.mark.parametrize("who", ["controlled", "agent"])
def test_tensors_take_the_same_steps(who):
    scenario = ieee13().replace(
        **HEAVY | {"horizon": 45}, **{"grid_control.regulators": who, "grid_control.capacitors": "agent"}
    )
    joint = commanded(scenario, tap=0.3, on=-1.0)
    ours = play(scenario, action=joint)[-1].state
    env: Any = TensorEnv(scenario, like=torch.zeros(1, dtype=torch.float64))
    env.reset([0, 1])
    for _ in range(scenario.horizon):
        env.step(torch.tensor(np.tile(joint, (2, 1))))
    np.testing.assert_allclose(env.state.v_pu.numpy(), ours.v_pu, atol=1e-7)
    (regulators, banks), (of_tensors, banks_of_tensors) = (s.three_phase.equipment for s in (ours, env.state))
    np.testing.assert_array_equal(of_tensors.tap.numpy(), regulators.tap)
    np.testing.assert_array_equal(banks_of_tensors.on.numpy(), banks.on)
    assert regulators.moves.sum() >= 3.0


def test_the_gradient_passes_the_rounded_tap():
    """A regulator commanded up by less than half a tap keeps its tap, but the derivative is positive."""
    scenario = ieee13().replace(grid_control={"regulators": "agent"}, background={"load_sigma": 0.0})
    base = scenario.feeder.base_tap
    joint = torch.tensor(commanded(scenario, tap=base / 16.0)[None], requires_grad=True)
    env: Any = TensorEnv(scenario, like=torch.zeros(1, dtype=torch.float64))
    env.reset([0])
    state = env.step(joint).state
    node = scenario.feeder.nodes_of("rg60", "a")[0]
    state.v_pu[0, node].backward()
    assert joint.grad is not None
    found = joint.grad[0, torch.tensor(action_layout(scenario).is_channel("tap"))].numpy()
    assert found[0] == pytest.approx(16 * 0.00625, rel=0.1)
    assert np.abs(found[1:]).max() < 0.1 * found[0]


def test_same_bits_in_any_environment():
    scenario = ieee13().replace(**HEAVY | {"background.load_sigma": 0.05}, **{"grid_control.capacitors": "agent"})
    batch: Any = DcgridVectorEnv(5, scenario)
    batch.reset(seed=3)
    one: Any = DcgridVectorEnv(1, scenario)
    one.reset(seed=[3 + 4])
    for _ in range(40):
        for env, n_env in ((batch, 5), (one, 1)):
            env.step(np.tile(commanded(scenario, on=1.0), (n_env, 1)))

    def same_bits(alone, together):
        np.testing.assert_array_equal(alone[0], together[4])
        return alone

    over_arrays(same_bits, one.transition.state, batch.transition.state)
    assert one.transition.state.three_phase.equipment.regulators.moves.sum() > 0.0


@pytest.mark.parametrize("observe", ["local", "feeder"])
def test_a_regulator_observes_what_its_relay_is_off_by(observe):
    """Line-drop compensation included, as the power flow has it, and free of the noise of other meters."""
    scenario = SCENARIOS["ieee123"]().replace(
        grid_control={"regulators": "agent"}, observe=observe, sensing={"noise_pu": 0.01}, horizon=3
    )
    transitions = play(scenario, action=commanded(scenario, tap=0.3))
    names, last = observation.field_names(scenario), transitions[-1]
    at = [i for i, name in enumerate(name for own in names.values() for name in own) if name == "relay"]
    settings, solved = relay_settings(scenario.feeder), last.state.three_phase.equipment.regulators.relay_v
    assert np.abs(np.diff([t.observation[:, at] for t in transitions], axis=0)).min() > 1e-5
    deviation = solved / settings.target_v - 1.0
    np.testing.assert_allclose(last.observation[:, at], deviation / scenario.cost.band_pu, atol=1e-6)
    low, high = observation.bounds(scenario)["reg_0"]
    own = names["reg_0"]
    assert (low[own.index("relay")], high[own.index("relay")]) == (low[0], high[0]) == (-20.0, 20.0)


@pytest.mark.slow
def test_the_relay_keeps_its_last_value_where_the_power_flow_has_none():
    scenario = ieee13().replace(
        grid_control={"regulators": "agent"},
        datacenters={"p_rated_kw": 40_000.0},
        trace="step",
        workload={"window": "start"},
        horizon=30,
    )
    *_, before, after = play(scenario, n_env=1, steps=20, action=commanded(scenario))
    assert not after.converged.any()
    np.testing.assert_array_equal(after.state.relay_v, before.state.relay_v)


def test_tensors_observe_the_relay_and_its_derivative():
    scenario = ieee13().replace(grid_control={"regulators": "agent"}, background={"load_sigma": 0.0})
    joint = torch.tensor(commanded(scenario, tap=scenario.feeder.base_tap / 16.0)[None], requires_grad=True)
    env: Any = TensorEnv(scenario, like=torch.zeros(1, dtype=torch.float64))
    env.reset([0])
    seen = env.step(joint).observation
    ours = play(scenario, n_env=1, steps=1, action=joint.detach().numpy()[0])[-1].observation
    np.testing.assert_allclose(seen.detach().numpy(), ours, atol=1e-6)
    names = observation.field_names(scenario)
    at = [name for own in names.values() for name in own].index("relay")
    seen[0, at].backward()
    assert joint.grad is not None
    found = joint.grad[0, torch.tensor(action_layout(scenario).is_channel("tap"))].numpy()
    settings = relay_settings(scenario.feeder)
    by_tap = settings.volts_per_tap[0, 0] / settings.target_v[0]
    assert found[0] == pytest.approx(16.0 * by_tap / scenario.cost.band_pu, rel=0.1)
