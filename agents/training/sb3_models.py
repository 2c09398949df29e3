"""Buffers for Stable-Baselines3 models before training, and policies from trained models."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
from dcgrid_env.agents.training.rows import AgentRows, Rows
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
    """The actor as a policy of NumPy arrays: in the shared view a network for each kind of agent."""
    mean, std = (buffer.cpu().numpy().astype(np.float64) for buffer in (normalised.mean, normalised.std))
    linear = [module for module in layers if isinstance(module, torch.nn.Linear)]
    weights = [(m.weight.detach().cpu().numpy().T, m.bias.detach().cpu().numpy()) for m in linear]
    rows = vec_env.rows
    if rows.form.outputs != "setpoint":
        weights[-1] = (weights[-1][0] * rows.reach, weights[-1][1] * rows.reach)
    networks = networks_of(rows, weights, activation, squash, mean, std, CLIP)
    return Policy(
        networks, observe=cfg.observe, preview=cfg.preview, act=cfg.act, nameplate=cfg.nameplate,
        outputs=rows.form.outputs, gains=rows.form.gains,
        scenario=trained_on(cfg), made_with=made_with(), channels=rows.further_channels,
    )  # fmt: skip


def networks_of(
    rows: Rows, weights: Sequence[tuple[np.ndarray, np.ndarray]], activation: str, squash: str,
    mean: np.ndarray | None, std: np.ndarray | None, clip: float | None,
) -> dict[str, Network]:  # fmt: skip
    """Make the networks of a policy whose layers act on a row: one, or in the shared view one for each kind of agent.

    The first bias contains the kind of agent and the entries that the agent does not observe: both are constant.

    Parameters
    ----------
    rows
        What a row is.
    weights
        (weight, bias) of each layer, (n_in, n_out) and (n_out,).
    activation, squash
        See :class:`Network`.
    mean, std, clip
        Normalisation of a row's observation, (n_observation,) each and a figure; none of them where there is none.
    """
    if not isinstance(rows, AgentRows):
        return {"joint": Network(weights, activation, squash, mean, std, clip)}
    networks = {}
    for name, members in rows.members.items():
        columns = rows.columns(rows.scenario.agents[members[0]])
        constant = np.zeros(len(weights[0][0]))
        constant[-len(rows.kinds) + 1 :] = [name == kind for kind in rows.kinds[1:]]
        constant = constant if mean is None or std is None else (constant - mean) / std
        constant = constant if clip is None else np.clip(constant, -clip, clip)
        constant[columns] = 0.0
        (first, bias), *rest = weights
        layered = [(first[columns], bias + constant @ first), *rest]
        last, last_bias = layered[-1]
        given = rows.entries(name)
        layered[-1] = (last[:, given], last_bias[given])
        own_mean, own_std = (None if moments is None else moments[columns] for moments in (mean, std))
        networks[name] = Network(layered, activation, squash, own_mean, own_std, clip)
    return networks
