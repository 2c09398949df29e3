"""Ratings of branches: loading against currents, the metrics, the observation, and the cost at its weight."""

import dataclasses

import numpy as np
import pytest
import torch

from dcgrid_env import Feeder, ScenarioError, ThreePhaseFeeder, load_feeder, make_scenario, scenario_hash, solver_for
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.engine.cost.observation import field_names, joint_bounds
from dcgrid_env.engine.cost.reward import largest_costs
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.envs.tensor import TensorEnv
from dcgrid_env.powerflow import ThreePhaseSolution, branch_loading, distflow, rated_nodes
from dcgrid_env.scenario.costs.overload import MOST_EXCESS, mean_overload
from helpers.three_phase import ieee13


def rated(scenario="toy6", rating_a=60.0, **overrides):
    """A preset whose branches 0 and 3 of the balanced feeder have a rating."""
    plain = make_scenario(scenario, horizon=overrides.pop("horizon", 8))
    ratings = np.full(plain.feeder.n_branch, np.nan)
    ratings[[0, 3]] = rating_a
    return plain.replace(feeder=dataclasses.replace(plain.feeder, rating_a=ratings), **overrides)


@pytest.mark.parametrize("power_flow", ["distflow", "lindistflow"])
def test_loading_is_the_current_over_the_rating(power_flow):
    feeder = rated().feeder
    assert isinstance(feeder, Feeder)
    ratio = np.array([1.0, 1.02, 0.98, 1.02, 1.0, 1.1])
    for one in (feeder, dataclasses.replace(feeder, voltage_ratio=ratio)):
        solution = solver_for(one, power_flow)(one, one.p_load_kw, one.q_load_kvar, 1.0)
        loading = branch_loading(one, solution)
        assert rated_nodes(one).tolist() == [1, 4]
        assert not loading[[0, 2, 3, 5]].any()
        exact = distflow(one, one.p_load_kw, one.q_load_kvar, 1.0)
        current_a = np.sqrt(exact.current_sq_pu) * 1000.0 / (np.sqrt(3.0) * one.base_kv)
        close = 1e-6 if power_flow == "distflow" else 0.02
        np.testing.assert_allclose(loading[[1, 4]], current_a[[0, 3]] / 60.0, rtol=close)
        assert loading[1] > 0.0


def test_on_three_phases_each_conductor_transformer_and_regulator_counts():
    scenario = ieee13().replace(horizon=4)
    network = scenario.feeder.network
    names = network.phase_line.name
    ratings = [np.nan if k % 2 else 100.0 + k for k in range(len(names))]
    of_kva = dict(zip(network.transformer.to_bus, network.transformer.kva, strict=True))
    line = dataclasses.replace(network.phase_line, rating_a=ratings)
    feeder = ThreePhaseFeeder.from_network(dataclasses.replace(network, phase_line=line))
    solution = solver_for(feeder, "sweep")(feeder, feeder.p_load_kw, feeder.q_load_kvar, 1.0)
    loading = branch_loading(feeder, solution)
    assert isinstance(solution, ThreePhaseSolution)
    assert feeder.rating_a is not None
    kinds = set()
    for node in rated_nodes(feeder):
        bus, parent = feeder.bus_ids[feeder.node_bus[node]], feeder.node_parent[node]
        kinds.add(feeder.branch_names[feeder.node_bus[node] - 1].split()[0])
        expected = solution.i_a[node] / feeder.rating_a[node]
        if node in feeder.regulated:  # the current before it is larger by the ratio of the tap
            expected *= max(1.0, solution.v_pu[node] / solution.v_pu[parent])
        assert loading[node] == pytest.approx(expected)
        if bus in of_kva:
            kv_ll = network.transformer.kv_ll_to[network.transformer.to_bus.index(bus)]
            assert feeder.rating_a[node] == pytest.approx(of_kva[bus] / (np.sqrt(3.0) * kv_ll))
    assert kinds == {"line", "transformer", "regulator"}
    assert loading[feeder.regulated].max() > (solution.i_a / feeder.rating_a)[feeder.regulated].max()
    course = rollout(
        scenario.replace(feeder=feeder, sensing={"loading": True}, weights={"overload": 1.0}), NoControl(), [0]
    )
    own = course.metrics()[0]
    assert own["loading_max_pct"] > 100.0
    assert own["cost_overload"] > 0.0
    assert scenario_hash(scenario.replace(feeder=feeder)) != scenario_hash(scenario)


def test_metrics_are_of_the_rated_branches_alone():
    s = rated(rating_a=360.0)
    recorder = rollout(s, NoControl(), [3])
    series = recorder.series(0)
    over = series.loading[1:, [1, 4]]
    own = recorder.metrics()[0]
    assert own["loading_max_pct"] == pytest.approx(100.0 * over.max())
    assert own["overloaded_branch_seconds_pct"] == pytest.approx(100.0 * (over > 1.0).mean())
    assert 0.0 < own["overloaded_branch_seconds_pct"] < 100.0
    assert "cost_overload" not in own
    assert "loading_max_pct" not in rollout(make_scenario("toy6", horizon=3), NoControl(), [3]).metrics()[0]


@pytest.mark.parametrize("reward", ["shared", "local"])
def test_the_cost_is_the_mean_excess_times_its_weight(reward):
    weight = 7.0
    plain = rated(rating_a=40.0, reward=reward)
    s = plain.replace(weights={"overload": weight})
    recorder, without = (rollout(one, NoControl(), [3]) for one in (s, plain))
    loading = recorder.series(0).loading[1:, [1, 4]]
    excess = np.clip(loading - 1.0, 0.0, MOST_EXCESS).mean(axis=1)
    assert excess.max() > 0.0
    np.testing.assert_allclose(recorder.series(0).costs["overload"], weight * excess)
    assert recorder.costs()[0] == pytest.approx(without.costs()[0] + weight * excess.mean())
    assert largest_costs(s)._asdict()["overload"] == weight * MOST_EXCESS
    assert mean_overload(s, 100.0 * np.ones((1, 6)))[0] <= 6.0 / 2.0 * MOST_EXCESS


def test_an_agent_sees_the_loading_of_the_branch_that_feeds_it():
    s = rated(rating_a=300.0, sensing={"loading": True})
    assert field_names(s)["dc_0"][7] == "loading"
    assert field_names(s)["inv_0"][7] == "loading"
    assert len(field_names(rated())["dc_0"]) == len(field_names(s)["dc_0"]) - 1
    env = TensorEnv(s, like=np.empty(0))
    joint = env.reset([0])
    low, high = joint_bounds(s)
    assert ((low <= joint) & (joint <= high)).all()
    at_dc = s.feeder.index(4)
    assert env.state.loading is not None
    assert joint[0, 7] == pytest.approx(env.state.loading[0, at_dc])
    assert joint[0, 7] > 1.0
    assert joint[0, len(field_names(s)["dc_0"]) + 7] == 0.0  # no rating is known of what feeds the first inverter


def test_the_cost_has_a_derivative():
    s = rated(rating_a=200.0, weights={"overload": 10.0, "voltage": 0.0, "violation": 0.0, "backlog": 0.0,
                                      "effort": 0.0, "leftover": 0.0}, horizon=30)  # fmt: skip
    env = TensorEnv(s, like=torch.empty(0, dtype=torch.float64))
    env.reset([0, 1])
    action = torch.zeros((2, action_layout(s).n), dtype=torch.float64, requires_grad=True)
    torch.stack([env.step(action).costs._asdict()["overload"].sum() for _ in range(25)]).sum().backward()
    assert action.grad is not None
    assert bool(torch.isfinite(action.grad).all())
    assert bool((action.grad[:, 0] > 0.0).all())  # a higher clock draws more


@pytest.mark.parametrize(("overrides", "said"), [
    ({"weights": {"overload": 2.0}}, r"weights\.overload is 2\.0; feeder 'toy6' has no rated branch; give"),
    ({"sensing.loading": True}, "sensing.loading is True; feeder 'toy6' has no rated branch; give"),
])  # fmt: skip
def test_a_feeder_without_ratings_has_neither(overrides, said):
    with pytest.raises(ScenarioError, match=said):
        make_scenario("toy6", **overrides)


def test_ratings_that_are_all_unknown_are_none():
    feeder = dataclasses.replace(load_feeder("toy6"), rating_a=np.full(5, np.nan))
    s = make_scenario("toy6", feeder=feeder, horizon=3)
    assert "loading_max_pct" not in rollout(s, NoControl(), [0]).metrics()[0]
    with pytest.raises(ScenarioError, match="has no rated branch"):
        s.replace(sensing={"loading": True})
