"""Train a policy with soft actor-critic (SAC) on a batch of feeders.

One policy is shared by all agents, or one policy controls all of them. The algorithm is that of Stable-Baselines3.

Reference: T. Haarnoja et al., "Soft actor-critic algorithms and applications", arXiv 1812.05905.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stable_baselines3 import SAC

from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training import sb3, sb3_models
from dcgrid_env.agents.training.batched_envs import RowVecEnv
from dcgrid_env.agents.training.run_folder import torch


@dataclass(frozen=True)
class Sac(sb3.OffPolicy):
    """Train a policy with SAC."""

    entropy_per_action: float = -2.0
    """Target entropy of the policy for each entry of an action; lower values mean less exploration."""


def make(cfg: Sac, vec_env: RowVecEnv) -> SAC:
    """Return the initialised algorithm."""
    entropy = cfg.entropy_per_action * float(vec_env.rows.used.sum(-1).mean())
    model = SAC("MlpPolicy", vec_env, **sb3_models.off_policy(cfg, vec_env), target_entropy=entropy)
    return sb3_models.prepared(model, vec_env, model.actor.mu)


def exported(cfg: Sac, vec_env: RowVecEnv, model: SAC) -> Policy:
    """Return the mean of the current policy as NumPy arrays."""
    actor: Any = model.actor
    return sb3_models.export(cfg, vec_env, actor.features_extractor, [*actor.latent_pi, actor.mu], "relu", "tanh")


def main(cfg: Sac) -> Path:
    """Train a policy and return the output folder."""
    with sb3.begin(cfg) as (run, vec_env):
        model = make(cfg, vec_env)
        temperature: dict[str, torch.Tensor] = {"log_ent_coef": model.log_ent_coef.data}  # pyright: ignore
        return sb3.train(
            cfg, run, vec_env, model,
            iterations=cfg.iterations(vec_env),
            exported=lambda: exported(cfg, vec_env, model),
            learning_rate=cfg.rate,
            extra=lambda: sb3_models.replay_arrays(model) | temperature,
        )  # fmt: skip
