"""What users of Stable-Baselines3 do around a training: monitor, evaluate, log, save, load, go on, repeat."""

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.vec_env import VecMonitor
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from dcgrid_env.agents import ppo_settings, sac_settings, sb3_vec_env

BOTH = pytest.mark.parametrize(("algorithm", "settings"), [(PPO, ppo_settings), (SAC, sac_settings)])


@pytest.mark.slow
def test_a_training_is_monitored_logged_and_its_best_model_kept_by_j(tmp_path):
    envs = VecMonitor(sb3_vec_env("toy6", 4, horizon=10), str(tmp_path / "train"), info_keywords=("J",))
    held_out = sb3_vec_env("toy6", 3, horizon=10, split="validation")
    seen: Any = VecMonitor(held_out, str(tmp_path / "evaluated"), info_keywords=("J",))
    callback = EvalCallback(
        seen, n_eval_episodes=seen.n_eval_episodes(3), eval_freq=10, best_model_save_path=str(tmp_path),
        log_path=str(tmp_path), verbose=0,
    )  # fmt: skip
    model = PPO(env=envs, seed=0, tensorboard_log=str(tmp_path / "log"), **ppo_settings(envs))
    model.learn(4 * 10 * envs.num_envs, callback)
    model.logger.close()
    envs.close()
    seen.close()
    (folder,) = (tmp_path / "log").iterdir()
    written = EventAccumulator(str(folder)).Reload()
    assert {"rollout/ep_rew_mean", "eval/mean_reward", "train/loss"} <= set(written.Tags()["scalars"])
    costs = [float(line.split(",")[-1]) for line in (tmp_path / "train.monitor.csv").read_text().splitlines()[2:]]
    assert len(costs) == 4 * envs.num_envs
    found = np.load(tmp_path / "evaluations.npz")["results"].mean(axis=1)
    assert found.max() == pytest.approx(callback.best_mean_reward)
    rows = np.genfromtxt(tmp_path / "evaluated.monitor.csv", delimiter=",", skip_header=1, names=True)
    np.testing.assert_allclose(rows["r"] / -10.0, rows["J"], rtol=1e-4)  # so the best model is that of the lowest J
    assert PPO.load(tmp_path / "best_model").num_timesteps % (10 * envs.num_envs) == 0


@BOTH
def test_a_loaded_model_goes_on_with_another_number_of_environments(algorithm, settings, tmp_path):
    envs = sb3_vec_env("toy6", 2, horizon=6)
    algorithm(env=envs, seed=0, **settings(envs)).learn(6 * envs.num_envs).save(tmp_path / "model")
    more = sb3_vec_env("toy6", 5, horizon=6)
    model = algorithm.load(tmp_path / "model", env=more)
    before = model.predict(more.reset())[0]
    assert before.shape == (more.num_envs, 1)
    model.learn(6 * more.num_envs, reset_num_timesteps=False)
    assert model.num_timesteps == 6 * (envs.num_envs + more.num_envs)
    with pytest.raises(ValueError, match="Action spaces do not match"):  # the same shapes with another meaning
        algorithm.load(tmp_path / "model", env=sb3_vec_env("toy6", 2, horizon=6, outputs="droop"))


TRAINING = """
import sys
from stable_baselines3 import PPO, SAC
from dcgrid_env.agents import ppo_settings, sac_settings, sb3_vec_env
envs = sb3_vec_env("toy6", 2, horizon=6)
PPO(env=envs, seed=3, **ppo_settings(envs)).learn(12 * envs.num_envs).save(sys.argv[1] + "/ppo")
SAC(env=envs, seed=3, **sac_settings(envs)).learn(4 * envs.num_envs).save(sys.argv[1] + "/sac")
"""


def content(path: Path) -> dict[str, Any]:
    """What a zip contains, without the times of the training and the addresses of objects."""
    with zipfile.ZipFile(path) as file:
        found: dict[str, Any] = {name: file.read(name) for name in file.namelist()}
    about = json.loads(re.sub(rb"0x[0-9a-f]+", b"", found.pop("data")))
    return found | {name: value for name, value in about.items() if name not in ("start_time", "ep_info_buffer")}


@pytest.mark.slow
def test_a_seed_gives_the_same_file_in_another_process(tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
        subprocess.run([sys.executable, "-W", "error", "-c", TRAINING, str(tmp_path / name)], check=True)
    for model in ("ppo.zip", "sac.zip"):
        first, second = (content(tmp_path / name / model) for name in "ab")
        assert {"policy.pth", "action_space", "num_timesteps"} <= set(first)
        assert first == second
