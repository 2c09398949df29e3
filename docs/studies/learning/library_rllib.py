"""PPO of RLlib, whose environment runner takes the rows of a batch as environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import ray  # pyright: ignore[reportMissingImports]
import torch
from ray.rllib.algorithms.ppo import PPOConfig  # pyright: ignore[reportMissingImports]
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig  # pyright: ignore[reportMissingImports]
from torch import nn

from docs.studies.learning.library_batches import DISCOUNTS, Outcome, Setting
from docs.studies.learning.library_loops import (
    EPOCHS,
    GRADIENT_NORM,
    HORIZON,
    LEARNING_RATE,
    LOG_STD,
    MINIBATCHES,
    best_mean,
    check_no_discount,
    initialise,
    n_updates,
    train_rows,
)

MODEL = DefaultModelConfig(fcnet_hiddens=[64, 64], fcnet_activation="tanh", vf_share_layers=False, free_log_std=True)
NAME = "DcgridRows-v0"
WITHOUT_DASHBOARD = {"include_dashboard": False, "num_cpus": 1, "log_to_driver": False}


class _Mean(nn.Module):
    """Mean actions of a module of RLlib."""

    def __init__(self, module: Any):
        super().__init__()
        self.module = module

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return self.module.forward_inference({"obs": observations})["action_dist_inputs"].chunk(2, -1)[0]


def rllib_ppo(on: Setting) -> Outcome:
    """Train PPO of RLlib in this process."""
    check_no_discount("rllib-ppo", on)
    envs = train_rows(on, autoreset_mode="next_step")
    n_row, batch = envs.num_envs, HORIZON * envs.num_envs
    ray.init(**WITHOUT_DASHBOARD)
    gymnasium.register(NAME, vector_entry_point=lambda **_: envs)
    config = (
        PPOConfig()
        .environment(NAME)
        .env_runners(
            num_env_runners=0, num_envs_per_env_runner=n_row, gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=HORIZON,
        )
        .rl_module(model_config=MODEL)
        .training(
            gamma=DISCOUNTS[on.reward], lambda_=0.0, lr=[[0, LEARNING_RATE], [on.steps * n_row // on.num_envs, 0.0]],
            train_batch_size_per_learner=batch, minibatch_size=batch // MINIBATCHES, num_epochs=EPOCHS,
            clip_param=0.2, use_kl_loss=False, vf_loss_coeff=0.5, vf_clip_param=float("inf"), grad_clip=GRADIENT_NORM,
            grad_clip_by="global_norm",
        )
        .debugging(seed=on.seed, log_level="ERROR")
    )  # fmt: skip
    algorithm: Any = config.build_algo()

    def prepare(learner: Any) -> None:
        module = learner.module["default_policy"]
        initialise(nn.ModuleList([module.encoder.actor_encoder, module.pi]), 0.01)
        initialise(nn.ModuleList([module.encoder.critic_encoder, module.vf]), 1.0)
        module.pi.log_std.data.fill_(LOG_STD)

    algorithm.learner_group.foreach_learner(prepare)
    algorithm.env_runner_group.sync_weights(from_worker_or_learner_group=algorithm.learner_group)
    best, updates = best_mean(_Mean(algorithm.get_module()), envs, on), n_updates(on)
    for update in range(updates):
        best.evaluate(update / updates)
        algorithm.train()
    tested = best.tested()
    algorithm.stop()
    ray.shutdown()
    gymnasium.registry.pop(NAME)
    return tested
