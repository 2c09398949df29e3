"""Stable-Baselines3 on the native batch: PPO with VecMonitor and EvalCallback, then the score of the best model.

``sb3_vec_env`` steps all environments with the same array operations. A row is a channel of an agent, an action of 0 is
no control, and training is paid by difference rewards. ``ppo_settings`` are the settings that go with it.

    python docs/examples/sb3_vec_env.py --scenario ieee33-weak --steps 200000
"""

from pathlib import Path

import torch
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.vec_env import VecMonitor

import dcgrid_env
from dcgrid_env.agents import ppo_settings, sb3_vec_env


def main(
    scenario: str = "ieee33-weak",
    steps: int = 200_000,
    num_envs: int = 32,
    episodes: int = 32,
    seed: int = 0,
    save: Path = Path("results/sb3_vec_env"),
) -> float:
    """Train for a number of environment steps, select on validation, and return the score on test episodes.

    The folder ``save`` gets best_model.zip, which ``dcgrid evaluate`` takes.
    """
    torch.set_num_threads(1)  # more threads slow down networks of this size
    made = sb3_vec_env(scenario, num_envs)
    envs = VecMonitor(made, info_keywords=("J",))  # each episode's J in ep_info_buffer
    held_out = sb3_vec_env(scenario, episodes, split="validation")  # where the reward is minus the cost
    n_eval: int = held_out.n_eval_episodes(episodes)  # a row is not an episode: each has a row for every channel
    every = max(1, steps // (10 * num_envs))
    callback = EvalCallback(
        VecMonitor(held_out), n_eval_episodes=n_eval, eval_freq=every, best_model_save_path=str(save), verbose=0
    )
    PPO(env=envs, seed=seed, **ppo_settings(envs)).learn(steps * made.rows_per_env, callback)
    result = dcgrid_env.score(str(save / "best_model.zip"), scenario, range(episodes))
    print(result)
    return result.score.value


if __name__ == "__main__":
    tyro.cli(main)
