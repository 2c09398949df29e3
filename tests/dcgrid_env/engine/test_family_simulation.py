"""Episodes on random feeders: identical in every environment, alone or in a batch with other feeders."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.spaces import flatdim

from dcgrid_env import (
    DcgridEnv,
    DcgridVectorEnv,
    RandomFeeders,
    ScenarioError,
    TensorEnv,
    episode_hash,
    forecast,
    make_scenario,
    parallel_env,
    scenario_hash,
)

FEEDERS = RandomFeeders(n_bus=20, style="us-mv", load_kw=1000.0, batch=4)
SETTINGS = {
    "feeder": FEEDERS,
    "datacenters.buses": None,
    "n_datacenters": 2,
    "datacenters.p_rated_kw": 300.0,
    "inverters.buses": (5, 10, 15),
    "inverters.s_rated_kva": 100.0,
    "horizon": 6,
}
SCENARIO = make_scenario("ieee33", name="on-random-feeders", **SETTINGS)
STEPS = 14


def test_a_difference_reward_is_that_of_the_episode_s_own_feeder():
    scenario = SCENARIO.replace(reward="difference", split="train")
    seeds = [0, 4, 8, 9]  # on three feeders
    batch = DcgridVectorEnv(len(seeds), scenario)
    batch.reset(seed=seeds)
    n_action = batch.single_action_space.shape[0]  # pyright: ignore[reportOptionalSubscript]
    actions = np.random.default_rng(1).uniform(-0.2, 0.2, (5, len(seeds), n_action)).astype(np.float32)
    together = []
    for action in actions:
        batch.step(action)
        together.append(batch.transition.reward_vector)
    members = [scenario.member(seed) for seed in seeds]
    assert len({member.feeder.name for member in members}) == 3
    for i, (seed, member) in enumerate(zip(seeds, members, strict=True)):
        alone = DcgridVectorEnv(1, member)
        alone.reset(seed=seed)
        by_itself = []
        for action in actions:
            alone.step(action[i : i + 1])
            by_itself.append(alone.transition.reward_vector)
        np.testing.assert_allclose(np.array(together)[:, i : i + 1], np.array(by_itself), rtol=1e-9, atol=1e-12)
        assert np.abs(np.array(by_itself)).max() > 1e-3


def course(env, n_env, seed):
    """Observations and rewards of environments, each of which begins its next episode where one is over."""
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (STEPS, n_env, env.single_action_space.shape[0])).astype(np.float32)
    observations, rewards = [env.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, *_ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    return actions, np.array(observations), np.array(rewards)


@pytest.mark.parametrize(("split", "seed"), [("train", 2), ("test", 62), ("ood", 0)])
def test_an_episode_is_the_same_alone_and_in_any_environment(split, seed):
    scenario = SCENARIO.replace(split=split)
    env = DcgridVectorEnv(4, scenario)
    actions, observations, rewards = course(env, 4, seed)
    one = DcgridEnv(scenario)
    assert one.observation_space == env.single_observation_space
    for env_index in (0, 3):
        observation, _ = one.reset(seed=seed + env_index)
        np.testing.assert_array_equal(observation, observations[0, env_index])
        for k in range(STEPS):
            observation, reward, terminated, truncated, _ = one.step(actions[k, env_index])
            assert reward == rewards[k, env_index]
            if terminated or truncated:
                observation, _ = one.reset()
            np.testing.assert_array_equal(observation, observations[k + 1, env_index])
            assert one.observation_space.contains(observation)


def test_the_parallel_and_the_tensor_environment_have_the_same_episode():
    scenario = SCENARIO.replace(split="test")
    one, agents, tensors = DcgridEnv(scenario), parallel_env(scenario), TensorEnv(scenario, like=np.empty(0))
    rng = np.random.default_rng(1)
    for seed in (0, 1):
        observation, _ = one.reset(seed=seed)
        local, info = agents.reset(seed=seed)
        np.testing.assert_array_equal(np.concatenate(list(local.values())), observation)
        np.testing.assert_allclose(tensors.reset([seed])[0], observation, atol=1e-5)
        assert agents.state().shape == agents.state_space.shape
        assert info["dc_0"]["bus"] in {int(bus) for bus in FEEDERS.bus_ids}
        for _ in range(3):
            action = rng.uniform(-1.0, 1.0, one.action_space.shape).astype(np.float32)
            observation, *_ = one.step(action)
            cuts = np.cumsum([flatdim(space) for space in agents.action_spaces.values()])[:-1]
            local, *_ = agents.step(dict(zip(agents.agents, np.split(action, cuts), strict=True)))
            np.testing.assert_array_equal(np.concatenate(list(local.values())), observation)
            stepped = tensors.step(action[None].astype(float))
            np.testing.assert_allclose(stepped.observation[0], observation, atol=1e-5)


def test_a_snapshot_goes_on_as_it_was_with_environments_on_several_feeders():
    env = DcgridVectorEnv(3, SCENARIO, split="validation", autoreset_mode="next_step")
    actions, *_ = course(env, 3, 7)
    saved = env.save()
    first = [env.step(action)[0] for action in actions[:8]]
    other = DcgridVectorEnv(3, SCENARIO, split="validation", autoreset_mode="next_step")
    other.reset(seed=0)
    other.restore(saved)
    np.testing.assert_array_equal(first, [other.step(action)[0] for action in actions[:8]])


@pytest.mark.slow
def test_another_process_draws_the_same_episode():
    code = (
        "from dcgrid_env import *; "
        "s = make_scenario('zero-shot', split='test'); print(scenario_hash(s), episode_hash(s, 5), "
        "*s.member(5).feeder.r_ohm[:9])"
    )
    test = make_scenario("zero-shot", split="test")
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert said == [scenario_hash(test), episode_hash(test, 5), *map(str, test.member(5).feeder.r_ohm[:9])]


def test_a_forecast_is_that_of_the_member():
    test = SCENARIO.replace(split="test")
    np.testing.assert_array_equal(forecast(test, 3).p_load_kw, forecast(test.member(3), 3).p_load_kw)
    assert test.member(3).family is test
    assert test.member(3) is test.member(67)
    assert [env_indices.tolist() for _, env_indices in test.members([0, 64, 1])] in ([[0, 1], [2]], [[2], [0, 1]])


@pytest.mark.slow
def test_gymnasium_makes_it_and_draws_its_feeder():
    env = gymnasium.make("dcgrid/ZeroShot-v0", render_mode="rgb_array", horizon=3)
    pictures = []
    for seed in (0, 200):
        env.reset(seed=seed)
        pictures.append(env.render())
    assert (pictures[0] != pictures[1]).any()
    env.close()


def test_what_cannot_be_is_refused_in_one_line_with_its_remedy():
    with pytest.raises(ScenarioError, match=r"observe is 'feeder'; .* choose 'local' or 'neighbours'"):
        SCENARIO.replace(observe="feeder")
    with pytest.raises(ScenarioError, match=r"2 episodes are on 2 feeders, .* give seeds within a multiple of 4"):
        TensorEnv(SCENARIO, like=np.empty(0)).reset([3, 4])
    with pytest.raises(ScenarioError, match="not drawn together; give num_envs=1"):
        DcgridVectorEnv(2, SCENARIO, render_mode="rgb_array")
    with pytest.raises(ScenarioError, match=r"datacenters\.count is 30; only"):
        SCENARIO.replace(n_datacenters=30)
    assert DcgridVectorEnv(2, SCENARIO.replace(observe="neighbours")).reset(seed=3)[0].shape[0] == 2


def test_a_file_says_it_whole(tmp_path):
    SCENARIO.to_toml(tmp_path / "on-random-feeders.toml")
    read = make_scenario(tmp_path / "on-random-feeders.toml")
    assert read.feeder == FEEDERS
    assert scenario_hash(read) == scenario_hash(SCENARIO)
    changed = SCENARIO.replace(feeder={"n_bus": 20, "style": "us-mv", "load_kw": 1000.0, "batch": 5})
    assert changed.difference(SCENARIO) == "feeder"
    assert scenario_hash(changed) != scenario_hash(SCENARIO)
