"""The native batch under Stable-Baselines3's own helpers, wrappers and algorithms."""

import subprocess
import sys
from typing import Any

import matplotlib
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, TD3
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import SubprocVecEnv, VecCheckNan, VecMonitor, VecNormalize, is_vecenv_wrapped

import dcgrid_env
from dcgrid_env import DcgridVectorEnv, ScenarioError, make_scenario
from dcgrid_env.agents import sb3_vec_env
from dcgrid_env.baselines import rollout

VIEWS = pytest.mark.parametrize("view", ["joint", "shared", "channel"])
PLAIN: dict[str, Any] = {"outputs": "setpoint", "nameplate": False, "reward": "shared"}
"""Observations, actions and rewards of ``gymnasium.make``."""
NOISE = NormalActionNoise(np.zeros(2), 0.2 * np.ones(2))
SMALL = {"device": "cpu", "gamma": 0.5, "seed": 0}


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


class Driver:
    """A model as dcgrid's controller."""

    def __init__(self, model):
        self.model = model

    def reset(self, env_info):
        pass

    def act(self, observations):
        return self.model.predict(observations, deterministic=True)[0]


def test_ids_presets_and_scenarios_make_the_same_batch():
    own = make_scenario("ieee33-weak", horizon=7)
    env = sb3_vec_env("dcgrid/IEEE33Weak-v0", 2, "joint", horizon=7, outputs="setpoint")
    for same in (
        env,
        sb3_vec_env("ieee33-weak", 2, "joint", horizon=7, outputs="setpoint"),
        sb3_vec_env(own, 2, "joint", outputs="setpoint"),
    ):
        assert same.get_attr("scenario") == [own] * 2
    assert sb3_vec_env(own, 2, "shared").num_envs == 2 * 7
    native = DcgridVectorEnv(2, own)
    env.seed(4)
    np.testing.assert_array_equal(env.reset(), native.reset(seed=4)[0])
    action = np.full((2, 10), 0.5, np.float32)
    np.testing.assert_array_equal(env.step(action)[0], native.step(action)[0])


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="view is 'each'; choose one of joint, shared"):
        sb3_vec_env("toy6", 1, "each")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="has regulators or capacitor banks among its agents"):
        sb3_vec_env("ieee13-3ph", 1, "shared", grid_control={"regulators": "agent"})
    with pytest.raises(ValueError, match="outputs is 'delta'; choose one of setpoint, change, droop"):
        sb3_vec_env("toy6", 1, outputs="delta")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="nameplate is True with view 'joint'; choose view 'shared'"):
        sb3_vec_env("toy6", 1, "joint", nameplate=True)
    with pytest.raises(ScenarioError, match="no scenario 'toy7'"):
        sb3_vec_env("toy7", 1)
    with pytest.raises(TypeError, match="no scenario field 'horizn'; did you mean horizon"):
        sb3_vec_env("toy6", 1, horizn=3)


@pytest.mark.slow
def test_it_says_what_it_needs():
    code = """
import sys
sys.modules["stable_baselines3"] = None
from dcgrid_env.agents import sb3_vec_env
try:
    sb3_vec_env("toy6", 1)
except ImportError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("sb3_vec_env needs Stable-Baselines3 (")
    assert "pip install 'stable-baselines3>=2.7'" in done.stdout


@VIEWS
def test_vec_monitor_logs_the_benchmarks_j(view, tmp_path):
    made = sb3_vec_env("ieee33-weak", 2, view, horizon=5, **PLAIN)
    env = VecMonitor(made, str(tmp_path / "log"), info_keywords=("J",))
    env.seed(3)
    env.reset()
    native = DcgridVectorEnv(2, "ieee33-weak", horizon=5)
    native.reset(seed=3)
    still = np.zeros((env.num_envs, *(env.action_space.shape or ())), np.float32)
    done, infos, of_native = np.zeros(0), [], {}
    for _ in range(5):
        *_, done, infos = env.step(still)
        *_, of_native = native.step(np.zeros((2, 10), np.float32))
    assert done.all()
    wanted = np.repeat(of_native["final_info"]["J"], env.num_envs // 2)
    np.testing.assert_array_equal([info["episode"]["J"] for info in infos], wanted)
    assert [info["episode"]["l"] for info in infos] == [5] * env.num_envs
    np.testing.assert_allclose([info["episode"]["r"] for info in infos], -5.0 * wanted, rtol=1e-5)
    env.close()
    _, header, *rows = (tmp_path / "log.monitor.csv").read_text().splitlines()
    assert header == "r,l,t,J"
    assert float(rows[-1].split(",")[-1]) == wanted[-1]


@VIEWS
def test_vec_normalize_scales_all_that_is_observed(view, tmp_path):
    plain = sb3_vec_env("ieee33-weak", 4, view, horizon=5)
    env: Any = VecNormalize(
        VecCheckNan(sb3_vec_env("ieee33-weak", 4, view, horizon=5), raise_exception=True), gamma=0.5
    )
    plain.seed(0)
    env.seed(0)
    seen: Any = plain.reset()
    scaled: Any = env.reset()
    all_seen, done, infos, ends = [seen], np.zeros(0), [], []
    for _ in range(5):
        action = np.full((env.num_envs, *(env.action_space.shape or ())), 0.3, np.float32)
        seen, _, _, ends = plain.step(action)
        all_seen.append(seen)
        scaled, paid, done, infos = env.step(action)
        assert np.isfinite(paid).all()
    assert done.all()
    np.testing.assert_allclose(env.obs_rms.mean, np.concatenate(all_seen).mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(env.normalize_obs(seen), scaled, atol=1e-6)
    for info, end in zip(infos, ends, strict=True):
        np.testing.assert_allclose(info["terminal_observation"], env.normalize_obs(end["terminal_observation"]))
    env.save(str(tmp_path / "means.pkl"))
    again: Any = VecNormalize.load(str(tmp_path / "means.pkl"), sb3_vec_env("ieee33-weak", 1, view, horizon=5))
    np.testing.assert_array_equal(again.obs_rms.mean, env.obs_rms.mean)


@VIEWS
def test_eval_callback_finds_the_j_of_the_benchmark(view, tmp_path):
    train: Any = VecNormalize(VecMonitor(sb3_vec_env("ieee123", 2, view, horizon=6)), gamma=0.5)
    held_out = VecMonitor(sb3_vec_env("ieee123", 3, view, horizon=6, split="validation"))
    evaluated: Any = VecNormalize(held_out, training=False, norm_reward=False)
    n: int = evaluated.n_eval_episodes(5)
    callback = EvalCallback(evaluated, n_eval_episodes=n, eval_freq=12, log_path=str(tmp_path), verbose=0)
    model = PPO("MlpPolicy", train, n_steps=12, batch_size=train.num_envs * 12, **SMALL)
    evaluated.seed(0)
    model.learn(2 * 12 * train.num_envs, callback)
    found = np.load(tmp_path / "evaluations.npz")
    assert found["timesteps"].tolist() == [12 * train.num_envs, 24 * train.num_envs]
    assert (found["ep_lengths"] == 6).all()
    assert [len(set(results.tolist())) for results in found["results"]] == [5, 5]
    np.testing.assert_array_equal(evaluated.obs_rms.mean, train.obs_rms.mean)
    assert callback.last_mean_reward == pytest.approx(found["results"][-1].mean())


def test_an_evaluation_is_the_benchmarks_own():
    scenario = make_scenario("ieee123", horizon=6, split="validation")
    env = VecMonitor(sb3_vec_env(scenario, 4, "joint", outputs="setpoint"))
    model = PPO("MlpPolicy", env, **SMALL)
    env.seed(0)
    returned: Any = evaluate_policy(model, env, n_eval_episodes=4)[0]
    wanted = rollout(scenario, Driver(model), range(4)).costs().mean()
    assert -returned / 6 == pytest.approx(wanted, rel=1e-5)


class Still:
    """A model whose actions are 0."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.zeros((len(observation), self.n_action), np.float32), None

    def __init__(self, env):
        (self.n_action,) = env.action_space.shape


@VIEWS
@pytest.mark.parametrize("episodes", [1, 3, 10])
def test_an_evaluation_counts_different_episodes(view, episodes):
    found: dict[float, int] = {}
    joint: dict[float, int] = {}
    shown: Any
    for kept, shown in ((found, view), (joint, "joint")):
        env: Any = VecNormalize(
            VecMonitor(sb3_vec_env("toy6", 3, shown, horizon=4, reward="shared")), norm_reward=False
        )
        env.seed(7)
        n: int = env.n_eval_episodes(episodes)
        returns, lengths = map(np.array, evaluate_policy(Still(env), env, n, return_episode_rewards=True))
        assert (lengths == 4).all()
        for value in returns.tolist():
            kept[value] = kept.get(value, 0) + 1
    assert len(joint) == episodes  # where a row is an environment
    rows = sb3_vec_env("toy6", 1, view).num_envs
    assert found == dict.fromkeys(joint, rows)  # the same episodes, each once for each of its rows


def test_a_number_of_episodes_that_cannot_be_evaluated_is_refused():
    for episodes in (0, -1, 2.0, True):
        with pytest.raises(ValueError, match=f"episodes is {episodes!r}; give a whole number of at least 1"):
            sb3_vec_env("toy6", 1).n_eval_episodes(episodes)  # pyright: ignore[reportArgumentType]


def test_only_training_goes_on_with_other_episodes():
    for split in ("train", "validation", "test"):
        env = sb3_vec_env("toy6", 2, split=split)
        begun: list[Any] = [env.reset()]
        for seed in (None, 5, None):
            env.step(np.zeros((env.num_envs, 1)))
            if seed is not None:
                env.seed(seed)
            begun.append(env.reset())
        same = [np.array_equal(*pair) for pair in ((begun[0], begun[1]), (begun[2], begun[3]), (begun[1], begun[2]))]
        assert same == [split != "train", split != "train", False]


@VIEWS
def test_what_helpers_ask_of_it(view):
    env = sb3_vec_env("toy6", 2, view)
    assert env.env_is_wrapped(Monitor) == [False] * env.num_envs
    assert not is_vecenv_wrapped(env, VecMonitor)
    assert is_vecenv_wrapped(VecMonitor(env), VecMonitor)
    assert env.has_attr("render_mode")
    assert not env.has_attr("no_such_thing")
    assert env.get_attr("render_mode", indices=[0, 1]) == [None, None]
    assert env.seed(5) == [5 + i for i in range(env.num_envs)]
    first = env.reset()
    env.reset()
    env.seed(5)
    np.testing.assert_array_equal(env.reset(), first)
    infos = env.step(np.zeros((env.num_envs, *(env.action_space.shape or ())), np.float32))[-1]
    infos[0]["mine"] = 1  # each row has a dict of its own
    assert infos[1] == {}


@VIEWS
@pytest.mark.slow
def test_images_of_each_environment(view):
    env = sb3_vec_env("toy6", 2, view, render_mode="rgb_array")
    env.seed(0)
    env.reset()
    single = dcgrid_env.DcgridEnv("toy6", render_mode="rgb_array")
    single.reset(seed=1)
    frames = env.get_images()
    assert len(frames) == 2
    np.testing.assert_array_equal(frames[1], single.render())
    tiled = env.render()
    assert tiled is not None
    assert tiled.size >= 2 * single.render().size
    with pytest.raises(RuntimeError, match="render_mode is None; make the rows with 'rgb_array'"):
        sb3_vec_env("toy6", 2, view).get_images()


@pytest.mark.slow
@pytest.mark.parametrize("start_method", ["spawn", "forkserver"])
def test_a_subprocess_imports_what_the_prefix_of_an_id_names(start_method):
    how: Any = {"vec_env_cls": SubprocVecEnv, "vec_env_kwargs": {"start_method": start_method}}
    env = make_vec_env("dcgrid_env:dcgrid/Toy6-v0", 2, seed=3, **how)
    try:
        np.testing.assert_array_equal(env.reset(), DcgridVectorEnv(2, "toy6").reset(seed=3)[0])
    finally:
        env.close()


def test_a_window_shows_the_first_environment(monkeypatch):
    monkeypatch.setattr(matplotlib, "get_backend", lambda: "agg")
    env = sb3_vec_env("toy6", 2, render_mode="human")
    env.seed(0)
    env.reset()
    assert env.render() is None


def mean_j(model, env):
    env.seed(0)
    returned: Any = evaluate_policy(model, env, n_eval_episodes=env.num_envs)[0]
    return -float(returned) / env.get_attr("scenario")[0].horizon


@pytest.mark.slow
def test_an_algorithm_without_settings_learns_set_points():
    train = VecNormalize(VecMonitor(sb3_vec_env("ieee123", 4, "shared", horizon=20, **PLAIN)), gamma=0.5)
    seen = VecMonitor(sb3_vec_env("ieee123", 8, "shared", horizon=20, split="validation", **PLAIN))
    held_out = VecNormalize(seen, training=False, norm_reward=False)
    train.seed(0)
    settings = {"learning_starts": 200, "batch_size": 128, "gradient_steps": 2, "action_noise": NOISE}
    model = TD3("MlpPolicy", train, learning_rate=1e-3, policy_kwargs={"net_arch": [32, 32]}, **SMALL, **settings)
    before = mean_j(model, held_out)
    model.learn(12_000)
    held_out.obs_rms = train.obs_rms
    after = mean_j(model, held_out)
    assert after < 0.85 * before
