"""What is put into a Stable-Baselines3 model before it is trained, and what is taken out of it: buffer and policy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import set_random_seed

from dcgrid_env.agents.policy.network import Network
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.batched_envs import AgentLanes, JointLanes
from dcgrid_env.agents.training.config import trained_on
from dcgrid_env.agents.training.run import torch
from dcgrid_env.agents.training.sb3 import Config, OffPolicy, episode_seed
from dcgrid_env.agents.training.torch_modules import CLIP
from dcgrid_env.agents.training.validation import made_with

SMALLEST_STD = 1e-4


def normalise(lanes: JointLanes, seed: int, gamma: float) -> dict[str, Any]:
    """Scale the lanes' rewards, so that returns are of order 1; policy arguments that normalise observations.

    Both by an episode in each environment, under clocks near the top and random setpoints; fixed from then on.
    """
    rng = np.random.default_rng(seed)
    shape = (lanes.num_envs, lanes.action_space.shape[0])  # pyright: ignore[reportOptionalSubscript]
    constant, seen, paid = rng.uniform(-1.0, 1.0, shape), [], []
    lanes.seed(episode_seed(seed, 0, lanes.n_envs))
    observation = lanes.reset()
    for _ in range(lanes.scenario.horizon):
        drawn = 0.3 * rng.standard_normal(shape)
        seen.append(observation)
        action = np.where(lanes.clocks, 1.0 - np.abs(drawn), constant + drawn)
        observation, reward, *_ = lanes.step(np.clip(action, -1.0, 1.0).astype(np.float32))
        paid.append(reward)
    lanes.reward_mean, lanes.reward_scale = float(np.mean(paid)), float((1.0 - gamma) / (np.std(paid) + 1e-8))
    each = np.concatenate(seen).astype(np.float64)
    known = {"mean": each.mean(axis=0), "std": np.maximum(each.std(axis=0), SMALLEST_STD)}
    return {"features_extractor_class": Normalised, "features_extractor_kwargs": known}


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


def off_policy(cfg: OffPolicy, lanes: JointLanes) -> dict[str, Any]:
    """Arguments that the algorithms with a replay buffer share; seeds the generators and normalises the lanes."""
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
        "policy_kwargs": {"net_arch": list(cfg.hidden), **normalise(lanes, cfg.seed, cfg.gamma)},
    }


def begun(model: Any, lanes: JointLanes, last: Any) -> Any:
    """The model with a logger that only remembers, and an actor whose ``last`` layer begins with clocks at the top."""
    with torch.no_grad():
        last.bias += 2.0 * torch.as_tensor(lanes.clocks, dtype=torch.float32, device=last.bias.device)
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def remembered(model: Any) -> dict[str, Any]:
    """What the replay buffer holds, as arrays; its position is that of the steps done."""
    buffer = model.replay_buffer
    buffer.pos = model.num_timesteps // buffer.n_envs % buffer.buffer_size
    buffer.full = model.num_timesteps // buffer.n_envs >= buffer.buffer_size
    names = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
    return {name: getattr(buffer, name) for name in names}


def export(
    cfg: Config, lanes: JointLanes, normalised: Normalised, layers: Iterable[torch.nn.Module], activation: str,
    squash: str,
) -> Policy:  # fmt: skip
    """The actor as a policy of NumPy arrays: in the shared view a network for each kind of agent.

    What an agent does not observe is constant in its lanes and goes into the first bias, and so does the kind.
    """
    mean, std = (buffer.cpu().numpy().astype(np.float64) for buffer in (normalised.mean, normalised.std))
    linear = [module for module in layers if isinstance(module, torch.nn.Linear)]
    weights = [(m.weight.detach().cpu().numpy().T, m.bias.detach().cpu().numpy()) for m in linear]
    if lanes.outputs != "setpoint":
        weights[-1] = (weights[-1][0] * lanes.reach, weights[-1][1] * lanes.reach)
    networks = {}
    if isinstance(lanes, AgentLanes):
        agents, n_dc = lanes.scenario.agents, lanes.scenario.n_datacenters
        for name, members, kind in (("datacenter", agents[:n_dc], 1.0), ("inverter", agents[n_dc:], 0.0)):
            if not members:
                continue
            own = lanes.columns(members[0])
            constant = np.zeros(len(mean))
            constant[-1] = kind
            constant = np.clip((constant - mean) / std, -CLIP, CLIP)
            constant[own] = 0.0
            (first, bias), *rest = weights
            layered = [(first[own], bias + constant @ first), *rest]
            if name == "inverter":
                last, last_bias = layered[-1]
                layered[-1] = (last[:, 1:], last_bias[1:])
            networks[name] = Network(layered, activation, squash, mean[own], std[own], CLIP)
    else:
        networks["joint"] = Network(weights, activation, squash, mean, std, CLIP)
    return Policy(
        networks, observe=cfg.observe, preview=cfg.preview, act=cfg.act, nameplate=cfg.nameplate,
        outputs=lanes.outputs, gains=lanes.gains,
        scenario=trained_on(cfg), made_with=made_with(),
    )  # fmt: skip
