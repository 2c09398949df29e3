"""The voltage cost charged from the utility's profile: worked by hand, in every interface, and refused where wrong."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from dcgrid_env import (
    DcgridVectorEnv,
    RandomFeeders,
    Scenario,
    ScenarioError,
    TensorEnv,
    ThreePhaseFeeder,
    action_layout,
    distflow,
    make_scenario,
    parallel_env,
    scenario_hash,
    voltage_deviation,
    voltage_targets,
)
from dcgrid_env.devices.tap_changer.relay import relay_settings, relay_volts
from dcgrid_env.devices.tap_changer.settling import settled_taps
from dcgrid_env.engine.cost.reward import largest_costs
from dcgrid_env.engine.family_simulation import simulation as simulation_of
from dcgrid_env.engine.simulation import Simulation
from dcgrid_env.powerflow import Control, solve_unbalanced

PROFILE = {"cost.reference": "profile"}


def charged_by_hand(scenario: Scenario, v_pu: np.ndarray) -> float:
    """Weighted voltage cost of the voltages of one environment, node by node."""
    targets, band = voltage_targets(scenario), scenario.cost.profile_band_pu
    nodes = scenario.feeder.load_nodes
    total = sum(max(abs(float(v_pu[i] - targets[i])) - band, 0.0) for i in nodes)
    return scenario.cost.weights.voltage * total / len(nodes)


def played(scenario: Scenario, n_env: int = 3, steps: int = 4) -> Any:
    """Transition after some steps of random actions."""
    simulation, rng = simulation_of(scenario, n_env), np.random.default_rng(0)
    simulation.reset(range(n_env))
    for _ in range(steps):
        simulation.step(rng.uniform(-1, 1, (n_env, action_layout(scenario).n)))
    return simulation.transition


def test_toy6_worked_by_hand():
    targets = {"1": 1.01, "2": 1.0, "3": 0.99, "4": 1.0, "5": 1.03}
    scenario = make_scenario("toy6", **PROFILE, **{"cost.profile_pu": targets, "cost.profile_band_pu": 0.01})
    names = scenario.feeder.node_ids
    assert [voltage_targets(scenario)[names.index(bus)] for bus in targets] == list(targets.values())
    v_pu = np.ones((1, 6))
    for bus, v in {"1": 1.01, "2": 1.009, "3": 0.97, "4": 1.08, "5": 1.0}.items():
        v_pu[0, names.index(bus)] = v
    # From the target: 0, .009, .02, .08, .03; beyond the band of .01: 0, 0, .01, .07, .02.
    found = voltage_deviation(scenario, v_pu)[0]
    expected = {"1": 0.0, "2": 0.0, "3": 0.01, "4": 0.07, "5": 0.02}
    assert [found[names.index(bus)] for bus in expected] == pytest.approx(list(expected.values()), abs=1e-12)


@pytest.mark.parametrize("kind", ["l1", "l2", "bowl", "courant_beltrami", "bump"])
def test_other_terms_are_charged_as_before(kind):
    overrides = {"weights": {"step": 20.0, "loss": 3.0}, "cost.voltage": kind, "cost.band_pu": 0.01, "horizon": 12}
    profile, nominal = (played(make_scenario("toy6", **overrides, **more)) for more in (PROFILE, {}))
    for name, value in profile.costs._asdict().items():
        same = np.array_equal(value, getattr(nominal.costs, name))
        assert same == (name != "voltage"), name
    assert (nominal.costs.violation > 0.0).any()


@pytest.mark.parametrize("name", ["toy6", "ieee33-weak", "ieee13-3ph", "ieee123-3ph"])
def test_a_step_is_charged_node_by_node(name):
    scenario = make_scenario(name, **PROFILE, **{"cost.profile_band_pu": 0.001})
    transition = played(scenario)
    for env_index in range(3):
        expected = charged_by_hand(scenario, transition.state.v_pu[env_index])
        assert expected > 0.0
        assert transition.costs.voltage[env_index] == pytest.approx(expected, rel=1e-12)


def test_the_plan_of_a_balanced_feeder_is_its_power_flow_without_devices():
    scenario = make_scenario("ieee33-weak", **PROFILE)
    feeder = scenario.feeder
    expected = distflow(feeder, feeder.p_load_kw, feeder.q_load_kvar - feeder.capacitor_kvar, 1.05).v_pu
    np.testing.assert_allclose(voltage_targets(scenario), expected, atol=1e-9)
    assert voltage_targets(scenario) is voltage_targets(scenario)
    assert not voltage_targets(scenario).flags.writeable


def test_the_cost_is_zero_at_the_profile():
    """Without sites, with quiet nominal loads and set points of 0, the grid is as planned."""
    quiet = {"n_datacenters": 0, "background.load_sigma": 0.0, "horizon": 3}
    scenario = make_scenario("ieee123", **quiet, **PROFILE, **{"cost.profile_band_pu": 0.0})
    env = DcgridVectorEnv(2, scenario)
    env.reset(seed=0)
    env.step(np.zeros((2, action_layout(scenario).n), np.float32))
    assert env.transition.costs.voltage == pytest.approx(0.0, abs=1e-5)
    nominal = DcgridVectorEnv(2, scenario.replace(cost={"reference": "nominal", "profile_band_pu": 0.0083}))
    nominal.reset(seed=0)
    nominal.step(np.zeros((2, action_layout(scenario).n), np.float32))
    assert (nominal.transition.costs.voltage > 1.0).all()


def test_the_plan_of_a_three_phase_feeder_has_its_regulators_in_band_at_their_published_settings():
    overrides = {"grid_control.regulators": "fixed", "source_voltage_pu": 1.03}
    scenario = make_scenario("ieee123-3ph", **PROFILE, **overrides)
    feeder: Any = scenario.feeder
    targets = voltage_targets(scenario)
    assert isinstance(feeder, ThreePhaseFeeder)
    assert targets.shape == (feeder.n_node,)
    # Some taps give exactly these voltages, with each relay within half its band.
    p_kw, q_kvar, on = feeder.p_load_kw[None], feeder.q_load_kvar[None], feeder.base_capacitor_on[None]
    settled = settled_taps(feeder, p_kw, q_kvar, scenario.source_voltage_pu, Control(None, None, on))
    assert settled.settled.all()
    control = Control(feeder.tap_ratio(settled.tap), None, on)
    solution = solve_unbalanced(feeder, p_kw, q_kvar, scenario.source_voltage_pu, control)
    np.testing.assert_array_equal(targets, solution.v_pu[0])
    settings = relay_settings(feeder)
    assert (np.abs(relay_volts(settings, solution)[0] - settings.target_v) <= settings.half_band_v).all()
    # The base taps of the tables, which the scenario keeps, give others.
    at_base = solve_unbalanced(feeder, p_kw, q_kvar, scenario.source_voltage_pu, Control(None, None, on)).v_pu[0]
    assert np.abs(at_base - targets).max() > 1e-3


def test_targets_of_nodes_of_buses_and_of_all():
    scenario = make_scenario("ieee13-3ph", **PROFILE)
    feeder, planned = scenario.feeder, voltage_targets(scenario)
    bus = next(bus for bus, phases in zip(feeder.bus_ids[1:], feeder.bus_phases[1:], strict=True) if phases == "abc")
    given = {f"{bus}.b": 1.02, bus: 0.99}  # the node's own counts, whatever the order
    targets = voltage_targets(scenario.replace(**{"cost.profile_pu": given}))
    for i, (node, of_bus) in enumerate(zip(feeder.node_ids, feeder.node_bus, strict=True)):
        expected = 1.02 if node == f"{bus}.b" else 0.99 if feeder.bus_ids[of_bus] == bus else planned[i]
        assert targets[i] == expected
    assert (voltage_targets(scenario.replace(**{"cost.profile_pu": 1})) == 1.0).all()
    at_one = scenario.replace(**{"cost.profile_pu": 1.0, "cost.profile_band_pu": 0.0})
    nominal = make_scenario("ieee13-3ph")
    assert np.array_equal(played(at_one).costs.voltage, played(nominal).costs.voltage)


@pytest.mark.parametrize("name", ["ieee33-weak", "ieee13-3ph"])
def test_a_local_reward_is_charged_from_the_target_at_the_agents(name):
    scenario = make_scenario(name, reward="local", weights={"violation": 0.0, "backlog": 0.0, "effort": 0.0}, **PROFILE)
    simulation = Simulation(scenario, 2)
    simulation.reset([0, 1])
    transition = simulation.step(np.zeros((2, action_layout(scenario).n)))
    targets, nodes = voltage_targets(scenario), simulation.now.episode.placed.nodes
    for env_index in range(2):
        for agent in range(scenario.n_agents):
            at = nodes[env_index, agent] - env_index * scenario.feeder.n_node
            off = abs(transition.state.v_pu[env_index, at].mean() - targets[at].mean())
            expected = -100.0 * max(off - scenario.cost.profile_band_pu, 0.0)
            assert transition.reward[env_index, agent] == pytest.approx(expected, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("name", ["ieee33-weak", "ieee13-3ph"])
def test_numpy_and_torch_agree(name):
    scenario = make_scenario(name, **PROFILE)
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 2, action_layout(scenario).n))
    envs = [TensorEnv(scenario, like=like) for like in (np.empty(0), torch.empty(0, dtype=torch.float64))]
    batch = DcgridVectorEnv(2, scenario)
    batch.reset(seed=[0, 1])
    for env in envs:
        env.reset([0, 1])
    for action in actions:
        of_numpy, of_torch = envs[0].step(action), envs[1].step(torch.tensor(action))
        batch.step(action)
        np.testing.assert_allclose(of_torch.costs.voltage.numpy(), of_numpy.costs.voltage, rtol=1e-6)
        np.testing.assert_allclose(of_numpy.costs.voltage, batch.transition.costs.voltage, rtol=1e-6)
    single = TensorEnv(scenario, like=torch.empty(0))  # float32
    single.reset([0, 1])
    assert single.step(torch.tensor(actions[0], dtype=torch.float32)).costs.voltage.dtype == torch.float32


@pytest.mark.parametrize(("name", "rtol"), [("toy6", 1e-4), ("ieee13-3ph", 1e-3)])
def test_the_gradient_matches_finite_differences(name, rtol):
    scenario = make_scenario(name, **PROFILE)
    like = torch.empty(0, dtype=torch.float64)
    start = np.random.default_rng(2).uniform(-0.5, 0.5, (1, action_layout(scenario).n))

    def cost(action: Any) -> Any:
        env = TensorEnv(scenario, like=like)
        env.reset([3])
        return env.step(action).costs.voltage.sum()

    action = torch.tensor(start, requires_grad=True)
    cost(action).backward()
    assert action.grad is not None
    numeric, h = np.zeros_like(start), 1e-3
    for i in range(start.shape[1]):
        ends = [cost(torch.tensor(start + sign * h * np.eye(start.shape[1])[i])) for sign in (1.0, -1.0)]
        numeric[0, i] = float(ends[0] - ends[1]) / (2.0 * h)
    scale = np.abs(numeric).max()
    assert scale > 1e-2
    np.testing.assert_allclose(action.grad.numpy(), numeric, rtol=rtol, atol=rtol * scale)


def test_each_random_feeder_has_its_own_profile():
    family = RandomFeeders(n_bus=20, batch=1)
    scenario = make_scenario("ieee123", feeder=family, horizon=3, **PROFILE, n_datacenters=2, inverters={"buses": ()})
    env = DcgridVectorEnv(3, scenario)
    env.reset(seed=[0, 1, 2])
    env.step(np.zeros((3, action_layout(scenario).n), np.float32))
    members = [scenario.member(seed) for seed in range(3)]
    targets = [voltage_targets(member) for member in members]
    assert np.abs(targets[0] - targets[1]).max() > 1e-4
    for env_index, member in enumerate(members):
        expected = charged_by_hand(member, env.transition.state.v_pu[env_index])
        assert env.transition.costs.voltage[env_index] == pytest.approx(expected, rel=1e-12)
    local = scenario.replace(reward="local")
    assert np.isfinite(played(local, steps=2).reward).all()


def test_every_interface_pays_the_same():
    scenario = make_scenario("toy6", **PROFILE)
    action = np.full(action_layout(scenario).n, 0.3, np.float32)
    single = gymnasium.make("dcgrid/Toy6-v0", disable_env_checker=True, cost={"reference": "profile"})
    single.reset(seed=0)
    info = single.step(action)[4]
    batch = DcgridVectorEnv(1, scenario)
    batch.reset(seed=[0])
    batch.step(action[None])
    agents: Any = parallel_env(scenario)
    agents.reset(seed=0)
    split = np.split(action, np.cumsum([agents.action_space(agent).shape[0] for agent in agents.agents])[:-1])
    infos: Any = agents.step(dict(zip(agents.agents, split, strict=True)))[4]
    paid = [info["cost_voltage"], float(batch.transition.costs.voltage[0]), infos["dc_0"]["cost_voltage"]]
    assert paid == pytest.approx([paid[0]] * 3, rel=1e-6)
    assert paid[0] == pytest.approx(charged_by_hand(scenario, batch.transition.state.v_pu[0]), rel=1e-6)


def test_a_voltage_without_a_solution_still_costs_the_most():
    assert largest_costs(make_scenario("toy6", **PROFILE)).voltage == 100.0


def test_a_scenario_file_and_the_hash_hold_the_profile(tmp_path):
    base = make_scenario("toy6")
    scenario = base.replace(**PROFILE, **{"cost.profile_pu": {2: 1.02, "4": 0.98}, "cost.profile_band_pu": 0.01})
    scenario.to_toml(tmp_path / "toy6.toml", base=base)
    again = make_scenario(tmp_path / "toy6.toml")
    assert again.difference(scenario) is None
    assert again.cost.profile_pu == (("2", 1.02), ("4", 0.98))
    hashes = {scenario_hash(s) for s in (base, scenario, base.replace(**PROFILE), again)}
    assert len(hashes) == 3


BAD = [
    ({"cost.profile_pu": 1.0}, r"cost\.profile_pu is 1\.0; set reference to 'profile'"),
    ({"cost.profile_band_pu": 0.01}, r"cost\.profile_band_pu is 0\.01; set reference to 'profile'"),
    ({"cost.reference": "flat"}, r"cost\.reference is 'flat'; choose one of nominal, profile"),
    (
        {**PROFILE, "cost.profile_band_pu": -0.01},
        r"cost\.profile_band_pu is -0\.01; give a finite number in \[0, 0\.2\]",
    ),
    ({**PROFILE, "cost.profile_pu": 2.0}, r"cost\.profile_pu is 2\.0; give a number in \[0\.8, 1\.2\], a mapping"),
    ({**PROFILE, "cost.profile_pu": True}, r"cost\.profile_pu is True; give a number in \[0\.8, 1\.2\]"),
    ({**PROFILE, "cost.profile_pu": {"2": 0.5}}, r"cost\.profile_pu\.2 is 0\.5; give a number in \[0\.8, 1\.2\]"),
    ({**PROFILE, "cost.profile_pu": {"9": 1.0}}, r"'9' is not charged; name buses of feeder 'toy6'"),
    ({**PROFILE, "cost.profile_pu": {"0": 1.0}}, r"'0' is not charged; name buses of feeder 'toy6'"),
    ({**PROFILE, "cost.profile_pu": [1.0, 1.0]}, r"cost\.profile_pu is \(1\.0, 1\.0\); give a number"),
]


@pytest.mark.parametrize(("changed", "message"), BAD)
def test_a_wrong_profile_is_refused_by_name(changed, message):
    with pytest.raises(ScenarioError, match=message):
        make_scenario("toy6", **changed)


def test_a_plan_without_a_solution_is_named():
    feeder = make_scenario("toy6").feeder
    scenario = make_scenario("toy6", feeder=feeder.scaled(200.0, 200.0), **PROFILE)
    with pytest.raises(ScenarioError, match=r"nominal loads of feeder .* has no solution .*; give cost\.profile_pu"):
        voltage_targets(scenario)
