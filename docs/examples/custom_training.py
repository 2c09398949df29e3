"""Custom rewards and observations for PPO of Stable-Baselines3, each scored on the standard J of test episodes.

python docs/examples/custom_training.py --change reward
"""

from typing import Any, Literal

import numpy as np
import torch
import tyro
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper, VecNormalize

import dcgrid_env
from dcgrid_env.agents import RowPolicy, ppo_settings, sb3_vec_env, to_policy

SCENARIO = "ieee33-weak"
FIELDS: dict[str, dict[str, Any]] = {
    "weights": {"weights": {"violation": 4000.0}},  # four times the standard one
    "sensing": {"sensing": {"preview": False}},
}


class SmallActions(VecEnvWrapper):
    """Charges each row for the size of its action."""

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions."""
        self.charged = 0.02 * np.abs(actions).sum(axis=-1)
        super().step_async(actions)

    def step_wait(self) -> Any:
        """Return the step with another reward; ``infos[row]["J"]`` stays."""
        rows, rewards, done, infos = self.venv.step_wait()
        return rows, rewards - self.charged, done, infos

    def reset(self) -> Any:
        """Begin episodes."""
        return self.venv.reset()


def features(rows: np.ndarray) -> np.ndarray:
    """Return the observations of rows and their squares."""
    return np.concatenate((rows, rows**2), axis=-1)


class Features(VecEnvWrapper):
    """Observations of rows through ``features``."""

    def __init__(self, envs: Any):
        super().__init__(envs, spaces.Box(-np.inf, np.inf, (2 * envs.observation_space.shape[0],)))

    def step_wait(self) -> Any:
        """Return the step with other observations."""
        rows, rewards, done, infos = self.venv.step_wait()
        for row in np.flatnonzero(done):
            infos[row]["terminal_observation"] = features(infos[row]["terminal_observation"])
        return features(rows), rewards, done, infos

    def reset(self) -> Any:
        """Begin episodes."""
        return features(self.venv.reset())


def main(
    change: Literal["none", "reward", "observation", "weights", "sensing"] = "none",
    steps: int = 60_000,
    num_envs: int = 32,
    episodes: int = 32,
    seed: int = 0,
) -> float:
    """Train for a number of environment steps, and return the score on test episodes."""
    torch.set_num_threads(1)  # more threads slow down networks of this size
    rows = sb3_vec_env(SCENARIO, num_envs, **FIELDS.get(change, {}))
    envs, settings = rows, ppo_settings(rows)
    if change == "reward":
        envs = SmallActions(rows)
    elif change == "observation":  # VecNormalize takes the place of the settings' scaling
        envs, settings["policy_kwargs"] = VecNormalize(Features(rows), norm_reward=False), {"log_std_init": -1.0}
    model = PPO(env=envs, seed=seed, **settings).learn(steps * rows.rows_per_env)
    policy: Any = model
    if isinstance(envs, VecNormalize):
        scaled = envs.normalize_obs
        policy = RowPolicy(lambda seen: model.predict(scaled(features(seen)), deterministic=True)[0])
    elif change == "sensing":  # the policy stays without the preview
        policy = to_policy(model, rows.scenario)
    result = dcgrid_env.score(policy, SCENARIO, range(episodes))
    print(result)
    return result.score.value


if __name__ == "__main__":
    tyro.cli(main)
