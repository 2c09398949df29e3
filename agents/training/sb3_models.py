"""Buffers for Stable-Baselines3 models before training, and policies from trained models."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import set_random_seed

from dcgrid_env.agents.policy.neural_network import Network
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.batched_envs import RowVecEnv
from dcgrid_env.agents.training.config import trained_on
from dcgrid_env.agents.training.observation_scaling import CLIP
from dcgrid_env.agents.training.row_networks import policy_of_rows
from dcgrid_env.agents.training.run_folder import torch
from dcgrid_env.agents.training.sb3 import Config, OffPolicy, episode_seed
from dcgrid_env.agents.training.validation import made_with

SMALLEST_STD = 1e-4


def normalise(vec_env: RowVecEnv, seed: int, gamma: float) -> dict[str, Any]:
    """Scale the rows' rewards, so that returns are of order 1; policy arguments that normalise observations.

    Both by an episode in each environment, under clocks near the top and random setpoints; fixed from then on.
    """
    each, paid = random_episode(vec_env, seed)
    vec_env.reward_mean, vec_env.reward_scale = float(np.mean(paid)), float((1.0 - gamma) / (np.std(paid) + 1e-8))
    each = each.astype(np.float64)
    moments = {"mean": each.mean(axis=0), "std": np.maximum(each.std(axis=0), SMALLEST_STD)}
    return {"features_extractor_class": Normalised, "features_extractor_kwargs": moments}


def random_episode(vec_env: RowVecEnv, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """What an episode in each environment shows and pays, under clocks near the top and random reactive setpoints.

    Observations, (step and row, n_observation), and rewards, (step, row).
    """
    rng = np.random.default_rng(seed)
    shape = (vec_env.num_envs, vec_env.action_space.shape[0])  # pyright: ignore[reportOptionalSubscript]
    constant, observed, paid = rng.uniform(-1.0, 1.0, shape), [], []
    vec_env.seed(episode_seed(seed, 0, vec_env.n_envs))
    observation = vec_env.reset()
    for _ in range(vec_env.scenario.horizon):
        drawn = 0.3 * rng.standard_normal(shape)
        observed.append(observation)
        action = np.where(vec_env.rows.clocks, 1.0 - np.abs(drawn), constant + drawn)
        observation, reward, *_ = vec_env.step(np.clip(action, -1.0, 1.0).astype(np.float32))
        paid.append(reward)
    return np.concatenate(observed), np.array(paid)


class Normalised(BaseFeaturesExtractor):
    """Features: the observation less its mean, over its standard deviation, cut at +-10."""

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, observation_space: spaces.Box, mean: np.ndarray, std: np.ndarray):
        super().__init__(observation_space, features_dim=observation_space.shape[0])
        self.register_buffer("mean", torch.as_tensor(mean, dtype=torch.float32))
        self.register_buffer("std", torch.as_tensor(std, dtype=torch.float32))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features of observations, (..., n_observation) each."""
        return ((observations - self.mean) / self.std).clamp(-CLIP, CLIP)


def off_policy(cfg: OffPolicy, vec_env: RowVecEnv) -> dict[str, Any]:
    """Arguments that the algorithms with a replay buffer share; seeds the generators and normalises the rows."""
    set_random_seed(cfg.seed)
    return {
        "gamma": cfg.gamma,
        "buffer_size": cfg.buffer,
        "batch_size": cfg.batch,
        "train_freq": 1,
        "gradient_steps": cfg.gradient_steps,
        "learning_starts": 0,
        "tau": cfg.tau,
        "device": cfg.device,
        "policy_kwargs": {"net_arch": list(cfg.hidden), **normalise(vec_env, cfg.seed, cfg.gamma)},
    }


def prepared(model: Any, vec_env: RowVecEnv, last: Any) -> Any:
    """Return the model with an in-memory logger and an actor whose ``last`` layer starts near rest."""
    with torch.no_grad():
        last.bias += 2.0 * torch.as_tensor(vec_env.rows.rest, dtype=torch.float32, device=last.bias.device)
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def replay_arrays(model: Any) -> dict[str, Any]:
    """Return the content of the replay buffer as arrays; its position is that of the steps done."""
    buffer = model.replay_buffer
    buffer.pos = model.num_timesteps // buffer.n_envs % buffer.buffer_size
    buffer.full = model.num_timesteps // buffer.n_envs >= buffer.buffer_size
    names = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
    return {name: getattr(buffer, name) for name in names}


def export(
    cfg: Config, vec_env: RowVecEnv, normalised: Normalised, layers: Iterable[torch.nn.Module], activation: str,
    squash: str,
) -> Policy:  # fmt: skip
    """Return the actor as a policy of NumPy arrays: in the shared view a network for each kind of agent."""
    mean, std = (buffer.cpu().numpy().astype(np.float64) for buffer in (normalised.mean, normalised.std))
    linear = [module for module in layers if isinstance(module, torch.nn.Linear)]
    weights = [(m.weight.detach().cpu().numpy().T, m.bias.detach().cpu().numpy()) for m in linear]
    row_network = Network(weights, activation, squash, mean, std, CLIP)
    return policy_of_rows(vec_env.rows, row_network, scenario=trained_on(cfg), made_with=made_with())
