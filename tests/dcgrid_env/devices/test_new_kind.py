"""A new kind of device: every interface takes it from its own file and its registration alone."""

import importlib.util
import pickle
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import dcgrid_env
from dcgrid_env import (
    DcgridVectorEnv,
    Device,
    Recorder,
    Scenario,
    ScenarioError,
    TensorEnv,
    make_scenario,
    register_device,
)
from dcgrid_env.agents import Network, Policy
from dcgrid_env.baselines import CONTROLLERS, ConstantQ, make_controller, rollout
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.devices import Channel, device_kind
from dcgrid_env.engine.cost.observation import FIELDS
from dcgrid_env.scenario.costs.grid_terms import TERMS
from helpers.needs import NEEDING_A_DEVICE

SPEC = importlib.util.spec_from_file_location("battery_of_the_tests", Path(__file__).with_name("battery.py"))
assert SPEC is not None
assert SPEC.loader is not None
batteries = importlib.util.module_from_spec(SPEC)
sys.modules[SPEC.name] = batteries
SPEC.loader.exec_module(batteries)
BATTERIES = register_device(batteries.Batteries)


def scenario(**overrides) -> Scenario:
    """toy6 with a battery of 500 kW and 5 kWh at bus 2, between the data centre and the inverters."""
    base = make_scenario("toy6", horizon=40)
    sites, inverters = base.devices
    battery = BATTERIES(buses=(2,), p_rated_kw=500.0, energy_kwh=5.0, cycling_weight=2.0)
    return base.replace(name="with-battery", devices=(sites, battery, inverters), **overrides)


def test_it_is_a_device_and_known_by_its_kind():
    assert isinstance(scenario().devices[1], Device)
    assert device_kind("battery") is BATTERIES
    with pytest.raises(ValueError, match="device kind 'battery' is that of Batteries; choose another name"):
        register_device(type("Other", (BATTERIES,), {}))


def test_agents_actions_and_observations():
    s = scenario()
    assert s.agents == ("dc_0", "bat_0", "inv_0", "inv_1")
    layout = dcgrid_env.action_layout(s)
    assert layout.names == (("dc_0", "clock"), ("dc_0", "q"), ("bat_0", "power"), ("inv_0", "q"), ("inv_1", "q"))
    env = dcgrid_env.parallel_env(s)
    observations, infos = env.reset(seed=0)
    assert env.action_space("bat_0").shape == (1,)
    assert dcgrid_env.field_names(s)["bat_0"][-1] == "stored"
    assert observations["bat_0"][-1] == pytest.approx(0.5)
    assert infos["bat_0"]["bus"] in (2, "2")
    observations, rewards, *_, infos = env.step({a: np.zeros(env.action_space(a).shape or ()) for a in env.agents})
    assert env.observation_space("bat_0").contains(observations["bat_0"])
    assert env.state_space.contains(env.state())
    assert infos["dc_0"]["stored_kwh"] == pytest.approx(2.5)
    assert set(rewards) == set(s.agents)


def test_energy_is_conserved_and_the_grid_feels_the_draw():
    s = scenario()
    env = DcgridVectorEnv(2, s)
    env.reset(seed=[0, 0])
    action = np.zeros((2, 5))
    action[:, 0] = 1.0
    action[:, 2] = [1.0, -1.0]  # charge, discharge
    recorder = Recorder(s, env.transition)
    before = env.transition.state.v_pu.copy()
    while not recorder.over:
        env.step(action)
        recorder.add(env.transition)
        if len(recorder._transitions) == 2:
            charging, discharging = env.transition.state.v_pu
            assert charging[2] < discharging[2] - 1e-3
            np.testing.assert_allclose(env.transition.state.p_kw[:, 1], [500.0, -500.0])
    for env_index, sign in ((0, 1.0), (1, -1.0)):
        series = recorder.series(env_index)
        gained = np.where(series.charged_kw > 0, 0.95 * series.charged_kw, series.charged_kw / 0.95)
        np.testing.assert_allclose(2.5 + np.cumsum(gained, axis=0) / 3600.0, series.stored_kwh[1:], atol=1e-9)
        assert series.stored_kwh.min() >= 0.0
        assert series.stored_kwh.max() <= 5.0
        assert series.metrics()["stored_end_kwh"] == pytest.approx(5.0 if sign > 0 else 0.0)
        assert series.metrics()["cost_cycling"] > 0.0
    assert before.shape == (2, 6)


def test_its_cost_is_charged_to_the_team_and_to_itself():
    one = dcgrid_env.parallel_env(scenario(reward="local"))
    one.reset(seed=0)
    action = {a: np.zeros(one.action_space(a).shape or ()) for a in one.agents} | {"bat_0": np.ones(1)}
    _, paid, *_, infos = one.step(action)
    shared = gymnasium.make("dcgrid/Toy6-v0", scenario=scenario())
    shared.reset(seed=0)
    joint = np.zeros(5, np.float32)
    joint[2] = 1.0
    *_, info = shared.step(joint)
    assert info["cost_cycling"] == pytest.approx(2.0)
    assert infos["bat_0"]["cost_cycling"] == pytest.approx(2.0)
    free = dcgrid_env.parallel_env(scenario(reward="local"))
    free.reset(seed=0)
    _, idle, *_ = free.step(action | {"bat_0": np.zeros(1)})
    assert paid["bat_0"] < idle["bat_0"] - 1.9


def test_gradients_pass_and_tensors_agree_with_arrays():
    s = scenario()
    env = TensorEnv(s, like=torch.empty(0, dtype=torch.float64))
    env.reset([0])
    action = torch.full((1, 5), 0.3, dtype=torch.float64, requires_grad=True)
    step = env.step(action)
    (slope,) = torch.autograd.grad(step.cost_j.sum(), action)
    assert slope[0, 2] != 0.0
    single = gymnasium.make("dcgrid/Toy6-v0", scenario=s)
    single.reset(seed=0)
    _, reward, *_ = single.step(np.full(5, 0.3, np.float32))
    assert float(step.cost_j.detach()) == pytest.approx(-float(reward), rel=1e-5)


def test_scenario_files_pickles_and_hashes(tmp_path):
    s = scenario()
    s.to_toml(tmp_path / "a.toml")
    again = make_scenario(tmp_path / "a.toml")
    assert again.difference(s) is None
    assert (
        dcgrid_env.scenario_hash(again)
        == dcgrid_env.scenario_hash(s)
        != dcgrid_env.scenario_hash(make_scenario("toy6"))
    )
    assert pickle.loads(pickle.dumps(s)).difference(s) is None
    larger = BATTERIES(buses=(2,), p_rated_kw=501.0, energy_kwh=5.0)
    other = s.replace(devices=(s.devices[0], larger, s.devices[2]))
    assert other.difference(s) == "devices"
    with pytest.raises(ScenarioError, match=r"devices\[0\].energy_kwh is -1.0; give one positive number"):
        s.replace(devices=[{"kind": "battery", "buses": ["2"], "p_rated_kw": 1.0, "energy_kwh": -1.0}])


def test_a_picture_calls_it_by_its_own_kind_and_name():
    env = dcgrid_env.DcgridEnv(scenario(), render_mode="rgb_array")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert np.ndim(env.render()) == 3
    figure: Any = env._viewer._figure
    named = {text.get_text() for text in figure.axes[0].texts}
    assert {"dc_0 (4)", "bat_0 (2)", "inv_0 (3)", "inv_1 (5)"} <= named
    signs = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert signs.count("battery, inverter") == 2  # the triangle on the map, and the curves
    env.close()


MADE_FOR_TWO_KINDS = ("feedback", "mpc-one-step", "mpc-messages", "mpc", "model-aided")


@pytest.mark.parametrize("name", [name for name in CONTROLLERS if name not in (*MADE_FOR_TWO_KINDS, *NEEDING_A_DEVICE)])
def test_a_law_leaves_the_channels_that_it_does_not_know_at_rest(name):
    s = scenario()
    run = rollout(s, make_controller(name), [0]).series(0)
    assert not run.charged_kw.any()
    sites, _, inverters = s.devices
    without = rollout(s.replace(devices=(sites, inverters)), make_controller(name), [0]).series(0)
    np.testing.assert_array_equal(run.f_mhz[0], without.f_mhz[0])
    np.testing.assert_allclose(run.q_kvar[1, [0, 2, 3]], without.q_kvar[1], rtol=1e-6)
    assert run.q_kvar[1, 1] == 0.0


def test_a_law_gives_reactive_power_by_whatever_device_has_the_channel():
    class Condensers(BATTERIES):
        kind = "condenser"

        @property
        def q_limit_kvar(self):
            return self.parameters.p_rated_kw

        @property
        def channels(self):
            rated = self.parameters.p_rated_kw
            return (
                Channel("q", "kvar", -rated, rated, rest=0.0 * rated),
                Channel("power", "kW", 0.0 * rated, rated, rated),
            )

    base = make_scenario("toy6", horizon=5)
    device = Condensers(buses=(2,), p_rated_kw=500.0, energy_kwh=5.0)
    s = base.replace(name="with-condenser", devices=(*base.devices, device))
    controller = ConstantQ(q_share=0.5)
    controller.reset(s)
    actions = controller.act(dcgrid_env.parallel_env(s).reset(seed=0)[0])
    np.testing.assert_array_equal(actions["bat_0"], [0.5, 1.0])  # its power at rest, which is the rating
    np.testing.assert_array_equal(actions["inv_1"], [0.5])


@pytest.mark.parametrize("name", [name for name in CONTROLLERS if name not in (*MADE_FOR_TWO_KINDS, *NEEDING_A_DEVICE)])
def test_a_law_does_the_same_whatever_the_order_of_the_devices(name):
    base = make_scenario("toy6", horizon=10)
    turned = base.replace(devices=base.devices[::-1])
    assert turned.agents == ("inv_0", "inv_1", "dc_0")
    costs = [rollout(s, make_controller(name), [0, 1]).costs() for s in (base, turned)]
    np.testing.assert_allclose(*costs, rtol=1e-9)


@pytest.mark.parametrize("name", MADE_FOR_TWO_KINDS)
def test_controllers_with_a_model_say_which_devices_or_which_order_they_refuse(name):
    with pytest.raises(ValueError, match=r"data centres and inverters alone; .* has devices of kind 'battery'"):
        rollout(scenario(), make_controller(name), [0])
    base = make_scenario("toy6")
    with pytest.raises(ValueError, match=r"data centres first .* has the order inverter, datacenter"):
        rollout(base.replace(devices=base.devices[::-1]), make_controller(name), [0])


def test_hindsight_and_policies_refuse_devices_that_they_do_not_know():
    with pytest.raises(ValueError, match="hindsight is made for data centres, inverters and storage alone"):
        hindsight(scenario(), 0)
    with pytest.raises(ValueError, match="toy6-ppo: has no network for agents of kind battery of with-battery"):
        Policy.load("toy6-ppo").reset(scenario())


def test_a_policy_has_a_network_for_it():
    networks = {
        name: Network([(np.zeros((n_in, n_out)), np.full(n_out, 0.25))])
        for name, (n_in, n_out) in {"datacenter": (9, 2), "battery": (8, 1), "inverter": (7, 1)}.items()
    }
    recorder = rollout(scenario(), Policy(networks, channels={"battery": ["power"]}), [0])
    np.testing.assert_allclose(recorder.series(0).charged_kw[1:, 0], 0.25 * 500.0)


def test_a_bus_is_taken_once_however_it_is_written():
    base = make_scenario("toy6")
    for buses in (("3",), (3,), (4,), ("2", 2)):
        extra = BATTERIES(buses=buses, p_rated_kw=1.0, energy_kwh=1.0)
        with pytest.raises(ScenarioError, match="where another device is"):
            base.replace(devices=(*base.devices, extra))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "capacitor"}, "kind is 'capacitor', which"),
        ({"kind": "late", "input": "wrokload"}, "input is 'wrokload'; choose one of"),
        ({"kind": "odd", "step": None}, "has no step"),
    ],
)
def test_a_class_that_is_no_device_is_refused_by_name(changes, message):
    members = {
        name: value for name, value in vars(BATTERIES).items() if name not in ("__dict__", "__weakref__")
    } | changes
    if members["step"] is None:
        del members["step"]
    other: Any = type("Other", (), members)
    with pytest.raises(ValueError, match=message):
        register_device(other)


@pytest.mark.parametrize("name", [*(term.name for term in TERMS if term.amount), *(field.name for field in FIELDS)])
def test_what_is_the_grids_no_device_may_call_its_own(name):
    class Greedy(BATTERIES):
        kind = "greedy"

        def cost_terms(self, horizon, dt_s):
            return tuple(term._replace(name=name) for term in super().cost_terms(horizon, dt_s))

    base, greedy = make_scenario("toy6"), Greedy(buses=(2,), p_rated_kw=1.0, energy_kwh=1.0)
    with pytest.raises(ScenarioError, match=f"'greedy' calls something '{name}', which is the grid's; rename it"):
        dcgrid_env.parallel_env(base.replace(devices=(*base.devices, greedy)))


def test_a_scenario_without_data_centres_runs_and_is_measured():
    base = make_scenario("toy6", horizon=3)
    alone = base.replace(devices=(base.devices[1],))
    assert alone.agents == ("inv_0", "inv_1")
    metrics = rollout(alone, make_controller("droop"), [0]).metrics()[0]
    assert metrics["delay_mean_s"] == 0.0
    assert metrics["clock_mean_pct"] == 100.0
