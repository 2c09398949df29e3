"""Settings of PPO, SAC and TD3: their form, errors and results."""

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecFrameStack, VecMonitor, VecNormalize

import dcgrid_env
from dcgrid_env.agents import ppo_settings, sac_settings, sb3_vec_env, td3_settings
from dcgrid_env.baselines import make_controller, rollout

EACH = pytest.mark.parametrize(
    ("algorithm", "settings"), [(PPO, ppo_settings), (SAC, sac_settings), (TD3, td3_settings)]
)


@EACH
def test_wrappers_change_nothing_and_untrained_policies_act_near_rest(algorithm, settings):
    envs = sb3_vec_env("ieee33-weak", 4)
    envs.seed(3)
    first = envs.reset()
    plain, wrapped = settings(envs), settings(VecNormalize(VecMonitor(envs), norm_obs=False))
    envs.seed(3)
    np.testing.assert_array_equal(envs.reset(), first)  # the scaling has an episode of its own
    objects = ("learning_rate", "action_noise")
    assert {name: value for name, value in plain.items() if name not in objects} == {
        name: value for name, value in wrapped.items() if name not in objects
    }
    assert plain["gamma"] == 0.0
    assert settings(sb3_vec_env("ieee33-weak", 4, reward="shared"))["gamma"] > 0.0
    model = algorithm(env=envs, seed=0, **plain)
    assert np.abs(model.predict(first, deterministic=True)[0]).max() < 0.5
    with torch.no_grad():
        extractor = (model.policy if algorithm is PPO else model.actor).features_extractor
        features = extractor(torch.as_tensor(first)).numpy()
    assert np.abs(features).max() < 10.0
    assert features.std() > 0.3


@EACH
def test_environments_whose_observations_cannot_be_scaled_are_refused(algorithm, settings):
    foreign = make_vec_env("dcgrid/Toy6-v0", 1)
    for envs in (foreign, gymnasium.make("dcgrid/Toy6-v0")):
        with pytest.raises(TypeError, match="give environments made by sb3_vec_env"):
            settings(envs)
    foreign.close()
    envs = sb3_vec_env("toy6", 1)
    for changed in (VecNormalize(envs), VecFrameStack(envs, 2)):
        with pytest.raises(
            ValueError, match=r"envs has the wrapper Vec.*make the settings from environments without it"
        ):
            settings(changed)


def test_longer_trainings_have_larger_rollouts():
    envs = sb3_vec_env("ieee33-weak", 32)
    short, long = ppo_settings(envs), ppo_settings(envs, steps=360_000)
    assert (short["n_steps"], long["n_steps"]) == (15, 90)
    assert (short["batch_size"], long["batch_size"]) == (15 * envs.num_envs / 4, 90 * envs.num_envs / 8)
    with pytest.raises(ValueError, match="steps is 0; give the steps of the training, at least 1"):
        ppo_settings(envs, steps=0)


def test_one_environment_with_an_episode_of_one_step_is_trained():
    envs = sb3_vec_env("toy6", 1, "joint", horizon=1)
    assert PPO(env=envs, **ppo_settings(envs)).learn(2).num_timesteps == 2


@pytest.mark.slow
@EACH
def test_a_short_training_costs_less(algorithm, settings):
    """PPO beats the tuned droop; SAC, with a quarter of the steps, costs less than no control."""
    torch.set_num_threads(1)
    envs, tested = sb3_vec_env("ieee33-weak", 16), sb3_vec_env("ieee33-weak", 16, split="validation")
    model = algorithm(env=envs, seed=0, **settings(envs))
    model.learn((30_000 if algorithm is PPO else 8_000) * envs.rows_per_env)

    def j(act):
        tested.seed(0)
        rows, ends = tested.reset(), []
        for _ in range(tested.scenario.horizon):
            rows, *_, ends = tested.step(act(rows))
        return np.mean([end["J"] for end in ends])

    scenario = dcgrid_env.make_scenario("ieee33-weak", split="validation")
    law, share = ("droop-tuned", 0.97) if algorithm is PPO else ("none", 0.7)
    compared = rollout(scenario, make_controller(law, scenario), range(16)).costs().mean()
    assert j(lambda rows: model.predict(rows, deterministic=True)[0]) < share * compared
