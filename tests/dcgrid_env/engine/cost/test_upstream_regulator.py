"""What agents observe of the regulator upstream of them: figures, delay, bounds, interfaces and training."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from stable_baselines3.common.env_checker import check_env as check_sb3_env

from dcgrid_env import (
    DcgridEnv,
    DcgridVectorEnv,
    ScenarioError,
    TensorEnv,
    make_scenario,
    parallel_env,
    scenario_hash,
)
from dcgrid_env.agents.algorithms.analytic import Analytic, Learner
from dcgrid_env.devices.tap_changer.regulator_view import upstream_regulators
from dcgrid_env.engine.cost.observation import field_names, joint_bounds
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.engine.simulation import Simulation
from helpers.row_envs import agent_envs
from helpers.three_phase import SCENARIOS, ieee13, ieee123, one_phase

FIELDS = ("upstream_tap", "upstream_relay", "upstream_timer")
JUMP = {
    "datacenters.p_rated_kw": 1500.0,
    "trace": "step",
    "workload.window": "start",
    "background.load_sigma": 0.0,
    "grid_control.regulator_settings": {"timer": "reset"},
    "horizon": 45,
}
"""Two sites that draw some 2.3 MW more from the interval before t = 20 s on."""


def seen_by(scenario, **sensing):
    return scenario.replace(sensing={"regulator": True, "regulator_delay_s": 0.0, **sensing})


def columns(scenario):
    """Positions of the three fields in the joint observation, (n_agent, 3)."""
    names = [name for fields in field_names(scenario).values() for name in fields]
    return np.array([[i for i, name in enumerate(names) if name == field] for field in FIELDS]).T


def course(scenario, like=None, seeds=(0,), actions=None) -> Any:
    """The three figures of each agent from the reset on, (T + 1, row, n_agent, 3): all clocks at the top by default."""
    like = np.empty(0) if like is None else like
    env, layout, at = TensorEnv(scenario, like=like), action_layout(scenario), columns(scenario)
    joints = [env.reset(seeds)]
    top = np.tile(layout.is_channel("clock").astype(float), (len(seeds), 1))
    for step in range(scenario.horizon):
        action = top if actions is None else actions[step]
        joints.append(env.step(action if isinstance(like, np.ndarray) else torch.tensor(action)).observation)
    return np.stack([np.asarray(joint) for joint in joints])[..., at]


def test_figures_after_a_jump_of_the_load():
    """Band 2 V around 122 V, 16 taps, 15 s before the first tap and 2 s between further ones."""
    scenario = seen_by(ieee13().replace(**JUMP))
    found = course(scenario)[:, 0]
    site, on_c, on_a = (scenario.agents.index(name) for name in ("dc_0", "inv_2", "inv_3"))
    np.testing.assert_allclose(found[:20, site], [[29 / 48, -0.046, 0.0]] * 20, atol=0.01)
    np.testing.assert_allclose(found[20:35, site, 2], np.arange(1, 16) / 15, atol=1e-6)
    np.testing.assert_allclose(found[34, [site, on_c, on_a], 0], [29 / 48, 11 / 16, 10 / 16])
    out_of_band_v = np.array([119.04, 120.20, 119.83]) - 122.0
    expected = [out_of_band_v.mean(), out_of_band_v[2], out_of_band_v[0]]
    np.testing.assert_allclose(found[34, [site, on_c, on_a], 1], expected, atol=0.01)
    # The first taps bring no phase back. The second ones are those of a and c, since b is in band when it looks again.
    np.testing.assert_allclose(found[35:37, site, 2], [1 / 2, 2 / 2], atol=1e-6)
    np.testing.assert_allclose(found[37, site], [34 / 48, (-1.43 - 0.98 - 0.61) / 3, 1 / 3], atol=0.01)
    np.testing.assert_allclose(found[37, on_a], [12 / 16, -1.43, 1 / 2], atol=0.01)
    np.testing.assert_allclose(found[-1, on_a], [13 / 16, -0.62, 0.0], atol=0.01)


def test_the_relay_is_off_from_its_target_in_force():
    plain = ieee13().replace(grid_control={"regulators": "fixed"}, background={"load_sigma": 0.0}, horizon=3)
    lower = plain.replace(grid_control={"regulator_settings": {"offset_v": -2.0}})
    before, after = (course(seen_by(one)) for one in (plain, lower))
    np.testing.assert_allclose(after[..., 1], before[..., 1] + 2.0)
    assert not after[..., 2].any()  # no control acts on fixed taps, in band or out of it


def test_set_points_of_agents_and_schedules_are_in_force():
    quiet = ieee13().replace(background={"load_sigma": 0.0, "start_hour": 6.0 - 5.0 / 3600.0}, horizon=10)
    timer = {"timer": "reset"}
    plain = course(seen_by(quiet.replace(grid_control={"regulator_settings": timer})))
    schedule = {"offset_v": {"reg1": [[0.0, 0.0], [6.0, 3.0]]}}
    scheduled = course(seen_by(quiet.replace(grid_control={"regulator_settings": timer | schedule})))
    np.testing.assert_allclose((scheduled - plain)[..., 1][:, 0, 0], [0.0] * 6 + [-3.0] * 5, atol=1e-6)

    chosen = seen_by(quiet.replace(grid_control={"regulators": "setpoint", "regulator_settings": timer}))
    layout = action_layout(chosen)
    action = layout.is_channel("clock").astype(float)
    offset, half_band = (
        next(channel for device in chosen.devices for channel in device.channels if channel.name == name)
        for name in ("offset", "half_band")
    )
    action[layout.is_channel("offset")] = 0.5
    action[layout.is_channel("half_band")] = -0.5
    offset_v = float(0.75 * offset.highest[0] + 0.25 * offset.lowest[0])
    half_v = float(0.25 * half_band.highest[0] + 0.75 * half_band.lowest[0])
    found = course(chosen, actions=np.tile(action, (chosen.horizon, 1, 1)))
    np.testing.assert_allclose(found[0, 0, 0], plain[0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(found[1:, 0, 0, 1], (plain[1:, 0, 0, 1] - offset_v) / half_v, atol=1e-6)


@pytest.mark.parametrize("timer", ["reset", "integrating"])
@pytest.mark.parametrize(("delay_s", "steps"), [(2.0, 2), (2.1, 3), (0.3, 1), (80_000.0, 45)])
def test_figures_are_as_old_as_the_delay(timer, delay_s, steps):
    scenario = ieee13().replace(**JUMP).replace(**{"grid_control.regulator_settings": {"timer": timer}})
    now, late = (course(seen_by(scenario, regulator_delay_s=delay)) for delay in (0.0, delay_s))
    np.testing.assert_array_equal(late[steps:], now[: len(now) - steps])
    np.testing.assert_array_equal(late[:steps], np.broadcast_to(now[0], late[:steps].shape))
    assert steps > 40 or np.abs(late - now).max() > 0.5


@pytest.mark.slow
def test_the_delay_is_two_seconds_by_default_whatever_the_step():
    for dt_s, steps in ((0.5, 4), (1.0, 2), (60.0, 1)):
        state = Simulation(ieee13().replace(sensing={"regulator": True}, dt_s=dt_s), 1).reset([0]).state
        assert state.regulator_views is not None
        assert len(state.regulator_views) == steps + 1
    assert Simulation(ieee13(), 1).reset([0]).state.regulator_views is None


def test_agents_without_a_regulator_upstream_observe_zeros():
    inverters = {"buses": ("650", "rg60"), "s_rated_kva": 100.0}
    found = course(seen_by(ieee13().replace(**JUMP, inverters=inverters)))
    assert not found[:, :, 2].any()
    np.testing.assert_array_equal(found[:, :, 3], found[:, :, 0])
    assert np.abs(found[:, :, 3]).min(0).max() > 0.5


def test_the_nearest_regulator_of_the_phase_is_the_one():
    feeder = ieee123().feeder
    found, names = upstream_regulators(feeder), feeder.network.regulator.name
    for node, row in enumerate(found):
        path = [node]
        while feeder.node_parent[path[-1]] >= 0:
            path.append(feeder.node_parent[path[-1]])
        regulated = [n for n in path if n in feeder.regulated]
        if not regulated:
            assert row == len(names)
            continue
        table = feeder.network.regulator
        assert feeder.bus_ids[feeder.node_bus[regulated[0]]] == table.to_bus[row]
        assert "abc"[feeder.node_phase[node] - 1] in table.phases[row]
    assert len(set(found.tolist())) == len(names) + 1


def test_a_regulator_that_may_make_no_tap_and_one_without_delays_have_finite_figures():
    scenario = seen_by(ieee13().replace(**JUMP))
    network = scenario.feeder.network
    n = len(network.regulator)
    for change in ({"max_taps_per_move": [0] * n}, {"delay_s": [0.0] * n, "tap_delay_s": [0.0] * n}):
        table = dataclasses.replace(network.regulator, **change)
        feeder = type(scenario.feeder).from_network(dataclasses.replace(network, regulator=table))
        found = course(scenario.replace(feeder=feeder, horizon=25))
        assert np.isfinite(found).all()
        assert found[..., 2].min() >= 0.0
        assert found[..., 2].max() <= 1.0


@pytest.mark.parametrize("timer", ["reset", "integrating"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_figures_never_leave_their_bounds(name, timer):
    """Under random actions and loads, before observations are cut to their bounds; torch equals NumPy."""
    scenario = seen_by(SCENARIOS[name]().replace(grid_control={"regulator_settings": {"timer": timer}}, horizon=40))
    scenario = scenario.replace(**{"datacenters.p_rated_kw": 700.0, "background.load_sigma": 0.2})
    rng, n = np.random.default_rng(3), action_layout(scenario).n
    actions = rng.uniform(-1.0, 1.0, (scenario.horizon, 2, n))
    found = course(scenario, seeds=(0, 1), actions=actions)
    low, high = (edge[columns(scenario)] for edge in joint_bounds(scenario))
    assert ((low <= found) & (found <= high)).all()
    assert np.abs(found[..., 1]).max() > 1.0
    assert found[..., 2].max() > 0.1
    like = torch.empty(0, dtype=torch.float64)
    np.testing.assert_allclose(course(scenario, like, (0, 1), actions), found, atol=1e-6)
    env = DcgridVectorEnv(2, scenario)
    joint, _ = env.reset(seed=0)
    for step in range(10):
        np.testing.assert_allclose(joint[:, columns(scenario)], found[step], atol=1e-5)
        joint, *_ = env.step(actions[step].astype(np.float32))


def test_gradients_pass_the_relay():
    scenario = seen_by(ieee13())
    env = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))
    env.reset([0])
    action = torch.zeros((1, action_layout(scenario).n), dtype=torch.float64, requires_grad=True)
    env.step(action).observation[0, columns(scenario)[0, 1]].backward()
    assert action.grad is not None
    is_q = torch.tensor(action_layout(scenario).is_channel("q"))
    assert (action.grad[0, is_q].abs() > 1e-4).any()


def test_episodes_without_a_power_flow_have_finite_observations():
    scenario = ieee13().replace(datacenters={"p_rated_kw": 1e6}, trace="step", workload={"window": "start"})
    begun = Simulation(seen_by(scenario.replace(source_voltage_pu=0.5)), 1).reset([0])
    assert not begun.converged.any()
    assert np.isfinite(begun.observation).all()


def test_partial_resets_and_restored_states_have_their_own_reports():
    scenario = seen_by(ieee13().replace(**JUMP), regulator_delay_s=3.0)
    batch, alone = Simulation(scenario, 2), Simulation(scenario, 1)
    action = np.tile(action_layout(scenario).is_channel("clock").astype(float), (2, 1))
    batch.reset([0, 1])
    for _ in range(24):
        batch.step(action)
    batch.reset([None, 5], mask=np.array([False, True]))
    saved = batch.now
    alone.reset([5])
    joints = []
    for _ in range(22):
        joints.append(batch.step(action).observation)
        np.testing.assert_array_equal(joints[-1][1], alone.step(action[:1]).observation[0])
    batch.restore(saved)
    for joint in joints:
        np.testing.assert_array_equal(batch.step(action).observation, joint)


def test_checkers_accept_the_environments():
    scenario = ieee13().replace(sensing={"regulator": True}, horizon=10)
    check_env(DcgridEnv(scenario), skip_render_check=True)
    check_sb3_env(DcgridEnv(scenario))
    parallel_api_test(parallel_env(scenario), num_cycles=20)


@pytest.mark.filterwarnings("ignore::dcgrid_env.agents.UnseenScenarioWarning")
@pytest.mark.parametrize("view", ["shared", "centralised"])
@pytest.mark.slow
def test_a_policy_trains_on_the_fields(view):
    scenario = seen_by(ieee13().replace(**JUMP)).replace(horizon=24)
    learner = Learner(Analytic(num_envs=2, window=12, hidden=(8,), view=view), [scenario])
    names = next(iter(learner.interfaces[0].input_fields.values()))
    weights = next(weight for weight in learner.networks.parameters() if weight.shape == (8, len(names)))
    before = weights.detach().clone()
    for iteration in (1, 2, 3):
        figures = learner.episodes(0, iteration, lambda what, tensors: None)
        assert np.isfinite(list(figures.values())).all()
    moved = (weights - before).abs().amax(0)
    for field in FIELDS:
        assert all(moved[i] > 0.0 for i, of in enumerate(names) if of.endswith(field)), field


def test_the_shared_view_of_stable_baselines3_has_the_fields():
    scenario = ieee13().replace(sensing={"regulator": True})
    vec_env = agent_envs(scenario, 2)
    at = [vec_env.rows.fields.index(field) for field in FIELDS]
    rows: Any = vec_env.reset()
    joint = vec_env.batch.transition.observation
    np.testing.assert_array_equal(rows[:, at], joint[:, columns(scenario)].reshape(-1, 3))
    assert np.abs(rows[:, at[0]]).min() > 0.1


def test_the_option_changes_the_hash_and_its_default_nothing():
    plain = make_scenario("ieee13-3ph")
    off = plain.replace(sensing={"regulator": False, "regulator_delay_s": 2.0})
    assert scenario_hash(off) == scenario_hash(plain)
    assert scenario_hash(plain.replace(sensing={"regulator": True})) != scenario_hash(plain)
    assert not set(FIELDS) & set(field_names(plain)["dc_0"])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: make_scenario("toy6"), "sensing.regulator is True; the balanced feeder 'toy6' has no regulator; give"),
        (one_phase, "sensing.regulator is True; the three-phase feeder 'one phase' has no regulator; give"),
        (lambda: make_scenario("zero-shot"), "sensing.regulator is True; the balanced feeder .* has no regulator"),
    ],
)
def test_feeders_without_regulators_refuse_the_option(make, message):
    scenario = make()
    with pytest.raises(ScenarioError, match=message):
        scenario.replace(sensing={"regulator": True})


@pytest.mark.parametrize("delay_s", [-1.0, float("nan"), "late", True])
def test_delays_that_cannot_be_are_refused(delay_s):
    with pytest.raises(ScenarioError, match=r"sensing.regulator_delay_s is .*; give a finite number"):
        ieee13().replace(sensing={"regulator_delay_s": delay_s})
