"""Train a policy with twin delayed deep deterministic policy gradient (TD3) on a batch of feeders.

One policy is shared by all agents, or one policy controls all of them. The algorithm is that of Stable-Baselines3.

Reference: S. Fujimoto et al., "Addressing function approximation error in actor-critic methods", arXiv 1802.09477.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import TD3
from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise

from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training import sb3, sb3_models
from dcgrid_env.agents.training.batched_envs import RowVecEnv


@dataclass(frozen=True)
class Td3(sb3.OffPolicy):
    """Train a policy with TD3."""

    noise: float = 0.2
    """Standard deviation of exploration noise."""
    target_noise: float = 0.1
    """Standard deviation of the noise that smooths the critics' targets."""


class BatchedNoise(VectorizedActionNoise):
    """Sample normal noise for all rows at once."""

    def __init__(self, std: float, vec_env: int, n_action: int):
        super().__init__(NormalActionNoise(np.zeros(n_action), std * np.ones(n_action)), 1)
        self.std, self.shape = std, (vec_env, n_action)

    def __call__(self) -> np.ndarray:
        """Return noise, (row, n_action)."""
        return self.std * np.random.standard_normal(self.shape).astype(np.float32)  # noqa: NPY002 (SB3 seeds this one)

    def reset(self, indices: object = None) -> None:
        """Do nothing, because the noise has no state."""


def make(cfg: Td3, vec_env: RowVecEnv) -> TD3:
    """Return the initialised algorithm."""
    noise = BatchedNoise(cfg.noise, vec_env.num_envs, vec_env.action_space.shape[0])  # pyright: ignore
    model = TD3(
        "MlpPolicy", vec_env, **sb3_models.off_policy(cfg, vec_env), action_noise=noise,
        target_policy_noise=cfg.target_noise, target_noise_clip=2.0 * cfg.target_noise,
    )  # fmt: skip
    model = sb3_models.prepared(model, vec_env, model.actor.mu[-2])
    model.actor_target.load_state_dict(model.actor.state_dict())
    return model


def exported(cfg: Td3, vec_env: RowVecEnv, model: TD3) -> Policy:
    """Return the current policy as NumPy arrays."""
    actor: Any = model.actor
    return sb3_models.export(cfg, vec_env, actor.features_extractor, actor.mu, "relu", "tanh")


def main(cfg: Td3) -> Path:
    """Train a policy and return the output folder."""
    with sb3.begin(cfg) as (run, vec_env):
        model = make(cfg, vec_env)
        return sb3.train(
            cfg, run, vec_env, model,
            iterations=cfg.iterations(vec_env),
            exported=lambda: exported(cfg, vec_env, model),
            learning_rate=cfg.rate,
            extra=lambda: sb3_models.replay_arrays(model),
        )  # fmt: skip
