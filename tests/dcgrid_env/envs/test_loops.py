"""Environments on a feeder with loops: all interfaces agree, and the branches that close loops count like others."""

from dataclasses import replace

import gymnasium
import matplotlib.pyplot as plt
import numpy as np
import pytest
import torch
from matplotlib.collections import LineCollection

from dcgrid_env import (
    DcgridEnv,
    DcgridVectorEnv,
    ScenarioError,
    TensorEnv,
    action_layout,
    load_feeder,
    scenario_hash,
    scenario_on,
)
from dcgrid_env.baselines import NoControl, rollout
from dcgrid_env.rendering.bus_positions import positions
from dcgrid_env.rendering.feeder_map import draw_feeder
from dcgrid_env.rendering.replay_map import feeder_map
from helpers.looped import ieee33_with_ties

HORIZON = 4


def scenario_of(feeder, **fields):
    return scenario_on(feeder, "3 x 1 MW at ends", "5 x 200 kvar").replace(horizon=HORIZON, split="train", **fields)


def actions(scenario, n_env):
    n = action_layout(scenario).n
    return np.random.default_rng(0).uniform(-1.0, 1.0, (HORIZON, n_env, n)).astype(np.float32)


def test_gymnasium_make_takes_a_feeder_with_loops():
    feeder = ieee33_with_ties(5)
    env = gymnasium.make("dcgrid/IEEE33-v0", feeder=feeder, horizon=HORIZON)
    env.reset(seed=0)
    for k in range(HORIZON):
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert np.isfinite(float(reward))
        assert not terminated
        assert truncated == (k == HORIZON - 1)
        assert np.isfinite(list(info.values())).all()


def test_loops_are_part_of_the_hash_of_a_scenario():
    hashes = {scenario_hash(scenario_of(ieee33_with_ties(n))) for n in (1, 2)}
    assert len(hashes | {scenario_hash(scenario_of(load_feeder("ieee33")))}) == 3


def test_rows_of_a_batch_are_the_episodes_of_one_environment():
    scenario = scenario_of(ieee33_with_ties(3, rating_a=150.0), sensing={"loading": True}, weights={"overload": 10.0})
    batch, given = DcgridVectorEnv(40, scenario), actions(scenario, 40)
    batch.reset(seed=3)
    rewards = np.array([batch.step(action)[1] for action in given])
    for row in (0, 17):
        env = DcgridEnv(scenario)
        env.reset(seed=3 + row)
        alone = [env.step(action)[1] for action in given[:, row]]
        np.testing.assert_allclose(rewards[:, row], alone, rtol=1e-12)


def test_tensors_have_the_costs_of_the_environment_and_their_derivative():
    scenario = scenario_of(ieee33_with_ties(3, rating_a=150.0), weights={"overload": 10.0, "loss": 1.0})
    like, given = torch.empty(0, dtype=torch.float64), actions(scenario, 3)

    def cost(moved):
        env, total = TensorEnv(scenario, like=like), torch.zeros((), dtype=torch.float64)
        env.reset(range(3))
        for action in moved:
            total = total + env.step(action).cost_j.sum()
        return total

    batch = DcgridVectorEnv(3, scenario)
    batch.reset(seed=0)
    tensors = [torch.tensor(action.astype(np.float64), requires_grad=True) for action in given]
    total = cost(tensors)
    assert float(total.detach()) == pytest.approx(-sum(batch.step(action)[1].sum() for action in given), rel=1e-5)
    total.backward()
    first = tensors[0]
    assert first.grad is not None
    way = torch.tensor(np.random.default_rng(1).normal(size=first.shape))
    with torch.no_grad():
        ends = [cost([first + step * way, *tensors[1:]]) for step in (1e-4, -1e-4)]
    assert float((first.grad * way).sum()) == pytest.approx(float(ends[0] - ends[1]) / 2e-4, rel=1e-3)


def test_the_overload_of_a_closing_branch_is_charged_and_in_the_metrics():
    feeder = ieee33_with_ties(3)
    only = replace(feeder, rating_a=np.where(np.arange(feeder.n_branch) == 33, 4.0, np.nan))
    run = rollout(scenario_of(only, weights={"overload": 1.0}), NoControl(), range(1))
    loading = run.series(0).loading
    assert loading.shape == (HORIZON + 1, feeder.n_branch + 1)
    assert not np.delete(loading, 34, axis=1).any()
    assert loading[1:, 34].min() > 1.0
    metrics = run.metrics()[0]
    assert metrics["loading_max_pct"] == pytest.approx(100.0 * loading[1:, 34].max())
    assert metrics["overloaded_branch_seconds_pct"] == 100.0


def test_a_collapse_ends_the_episode_of_its_row_alone():
    feeder = ieee33_with_ties(2, rating_a=150.0)
    scenario = scenario_of(feeder, datacenters={"p_rated_kw": 60_000.0}, sensing={"loading": True})
    batch, action = DcgridVectorEnv(2, scenario), actions(scenario, 2)[0]
    batch.reset(seed=0)
    action[0, 0::2], action[1] = 1.0, -1.0
    terminated = np.zeros(2, bool)
    for _ in range(HORIZON):
        _, rewards, over, _, _ = batch.step(action)
        terminated |= over
        assert np.isfinite(rewards).all()
    assert terminated[0]


def test_lindistflow_is_refused_when_the_scenario_is_made():
    with pytest.raises(ScenarioError, match=r"power_flow.*give 'distflow' for feeder 'ieee33', which has loops"):
        scenario_of(ieee33_with_ties(1), power_flow="lindistflow")


def test_maps_show_the_branches_that_close_loops():
    feeder = ieee33_with_ties(2)
    drawn = []
    for one in (feeder, load_feeder("ieee33")):
        figure, ax = plt.subplots()
        draw_feeder(ax, one, positions(one), np.ones(33), [5])
        lines = [artist for artist in ax.collections if isinstance(artist, LineCollection)]
        drawn.append(sum(len(line.get_segments()) for line in lines))
        plt.close(figure)
    assert drawn[0] - drawn[1] == 2
    run = rollout(scenario_of(feeder), NoControl(), range(1)).series(0)
    assert feeder.loop_ends is not None
    assert feeder_map(run)["loops"] == feeder.loop_ends.tolist()
    assert len(feeder_map(run)["parent"]) == 32
