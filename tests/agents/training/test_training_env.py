"""The rows of a batch as a vector environment of Gymnasium: the same as under Stable-Baselines3, and without it."""

import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

from dcgrid_env.agents import ppo_settings, sb3_vec_env, training_env


def normal(envs, seed=0):
    """Actions of which some leave the range."""
    return np.random.default_rng(seed).normal(size=(envs.num_envs, *envs.single_action_space.shape))


@pytest.mark.parametrize(
    ("scenario", "fields"),
    [
        ("ieee33-weak", {}),
        ("ieee33-weak", {"view": "shared", "split": "test"}),
        ("toy6", {"view": "joint"}),
        ("toy6", {"outputs": "change", "reward": "shared"}),
    ],
)
def test_rows_rewards_and_costs_are_those_of_stable_baselines3(scenario, fields):
    envs: Any = training_env(scenario, 3, horizon=4, scale_observations=False, **fields)
    rows: Any = sb3_vec_env(scenario, 3, horizon=4, **fields)
    assert envs.single_action_space == rows.action_space
    assert envs.single_action_space.form == rows.action_space.form
    assert envs.single_observation_space == rows.observation_space
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    rows.seed(7)
    seen, infos = envs.reset(seed=7)
    np.testing.assert_array_equal(seen, rows.reset())
    for step in range(9):  # two episodes and a step
        assert infos == {}
        action = normal(envs, step)
        seen, paid, terminated, truncated, infos = envs.step(action)
        expected, reward, done, ends = rows.step(action.clip(-1.0, 1.0).astype(np.float32))
        np.testing.assert_array_equal(seen, expected)
        np.testing.assert_allclose(paid, reward, rtol=1e-6, atol=1e-7)
        np.testing.assert_array_equal(terminated | truncated, done)
        assert done.all() == (step % 4 == 3)
        if done.any():
            assert infos["_final_obs"].all()
            np.testing.assert_array_equal(infos["final_info"]["J"], [end["J"] for end in ends])
            for last, end in zip(infos["final_obs"], ends, strict=True):
                np.testing.assert_array_equal(last, end["terminal_observation"])
            infos = {}


def test_scaling_is_that_of_the_settings_and_the_same_on_each_split():
    envs: Any = training_env("ieee33-weak", 2)
    raw = training_env("ieee33-weak", 2, scale_observations=False)
    scaled, plain = envs.reset(seed=0)[0], raw.reset(seed=0)[0]
    assert envs.single_observation_space.contains(scaled[0])
    made = sb3_vec_env("ieee33-weak", 2, split="test")  # scaled as in training all the same
    kwargs = ppo_settings(made)["policy_kwargs"]
    extractor = kwargs["features_extractor_class"](made.observation_space, **kwargs["features_extractor_kwargs"])
    np.testing.assert_allclose(extractor(torch.as_tensor(plain)).numpy(), scaled, atol=1e-5)
    np.testing.assert_array_equal(envs.scaling(plain), scaled)
    tested: Any = training_env("ieee33-weak", 1, split="test")
    np.testing.assert_array_equal(tested.scaling.mean, envs.scaling.mean)


def test_only_the_rows_of_a_collapsed_environment_begin_anew():
    heavy: dict[str, Any] = {"datacenters": {"p_rated_kw": 6000.0}}
    envs: Any = training_env("ieee33-weak", 3, outputs="setpoint", scale_observations=False, **heavy)
    first, _ = envs.reset(seed=0)
    seen, paid, terminated, truncated, infos = envs.step(np.ones(envs.action_space.shape))
    assert terminated.reshape(3, -1).tolist() == [[env == 1] * envs.rows.per_env for env in range(3)]
    assert not truncated.any()
    assert np.isfinite(paid).all()
    assert np.isfinite(seen).all()
    for name in ("_final_obs", "_final_info"):
        np.testing.assert_array_equal(infos[name], terminated)
    assert [last is not None for last in infos["final_obs"]] == terminated.tolist()
    assert ((infos["final_info"]["J"] > 100.0) == terminated).all()
    assert np.abs(seen - first)[terminated].max() > 1e-3  # of another episode


@pytest.mark.parametrize("action_repeat", [1, 3])
def test_the_next_step_begins_an_episode_in_that_mode(action_repeat):
    horizon = 2 * action_repeat
    envs: Any = training_env("toy6", 2, horizon=horizon, action_repeat=action_repeat, autoreset_mode="next_step")
    first, _ = envs.reset(seed=0)
    envs.step(normal(envs))
    last, _, _, truncated, infos = envs.step(normal(envs))
    assert truncated.all()
    assert infos["_J"].all()
    assert (infos["J"] > 0.0).all()
    after, paid, _, truncated, infos = envs.step(normal(envs))
    assert not truncated.any()
    assert infos == {}
    assert (paid == 0.0).all()
    assert np.abs(after - last).max() > 1e-3
    assert after.shape == first.shape
    envs.step(normal(envs))
    assert not envs.batch.transition.truncated.any()
    assert envs.step(normal(envs))[3].all()  # the action of the step before was ignored for all of its time


def test_wrappers_of_gymnasium_count_episodes():
    envs: Any = gymnasium.wrappers.vector.RecordEpisodeStatistics(training_env("toy6", 2, split="test", horizon=3))
    envs.reset(seed=0)
    infos: Any = {}
    for _ in range(3):
        *_, infos = envs.step(np.zeros(envs.action_space.shape))
    np.testing.assert_allclose(infos["episode"]["r"] / -3.0, infos["final_info"]["J"], rtol=1e-6)
    assert (infos["episode"]["l"] == 3).all()
    envs.close()


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="autoreset_mode is 'disabled'; choose same_step or next_step"):
        training_env("toy6", 1, autoreset_mode="disabled")  # pyright: ignore[reportArgumentType]
    envs: Any = training_env("toy6", 2)
    with pytest.raises(ValueError, match="3 seeds for num_envs = 2"):
        envs.reset(seed=[0, 1, 2])
    envs.reset(seed=[4, 9])
    with pytest.raises(ValueError, match=r"actions has the shape \(2,\); give \(\d+, 1\)"):
        envs.step(np.zeros(2))
    with pytest.raises(ValueError, match="nan"):
        envs.step(np.full(envs.action_space.shape, np.nan))


@pytest.mark.slow
def test_it_needs_neither_torch_nor_stable_baselines3():
    code = """
import sys
from dcgrid_env.agents import training_env
envs = training_env("toy6", 2)
envs.reset(seed=0)
envs.step(envs.action_space.sample())
assert not {"torch", "stable_baselines3"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
