"""Proximal policy optimisation on a batch of feeders: one policy for all agents, or one agent for all actuators.

J. Schulman et al., "Proximal policy optimization algorithms", arXiv 1707.06347, as Stable-Baselines3 has it. What is
ours: rollouts are whole episodes of all rows, collected and bootstrapped by array operations; the critic, which only
training needs, sees all agents of an environment (C. Yu et al., "The surprising effectiveness of PPO in cooperative
multi-agent games", arXiv 2103.01955) and is computed once for all of them; an entry of an action that never reaches the
grid, as an inverter's clock, counts for nothing in the likelihood; means are drawn back into the actions' range, beyond
which there is nothing to learn from.

Every agent is paid the team's reward. Where training may use the grid's model, ``ppo-counterfactual``, which pays each
for what its own action changed, scores higher on the presets where both were compared (docs/training.md). This one
needs no model, and drives devices of every kind, on every cost.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import create_mlp
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.utils import set_random_seed

from dcgrid_env.agents.policy.interface import Gains
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training import sb3, sb3_models
from dcgrid_env.agents.training.batched_envs import JointVecEnv, Outputs
from dcgrid_env.agents.training.run_folder import torch
from dcgrid_env.agents.training.setting_bounds import MOST_GAIN


@dataclass(frozen=True)
class Ppo(sb3.Config):
    """Train a policy with PPO."""

    outputs: Outputs = "setpoint"
    """Network outputs: setpoints, changes from the action that keeps the current state, or corrections of a droop."""
    gains: tuple[float, float, float] | None = None
    """Gains of that droop: k_p in MW/p.u., k_q in Mvar/(p.u. s), alpha in 1/s. Those of the tuned droop by default."""
    steps: int = 10_000_000
    """Steps in all: of agents where one policy is shared, of environments where it is centralised."""
    gae_lambda: float = 0.8
    """Decay lambda of generalised advantage estimation."""
    learning_rate: float = 3e-3
    """At the beginning; it falls linearly to nothing."""
    epochs: int = 3
    """Passes over each rollout."""
    minibatches: int = 8
    """Parts of a pass."""
    clip: float = 0.2
    """Largest change of the likelihood ratio that pays."""
    log_std: float = -0.7
    """Logarithm of the exploration's standard deviation at the beginning."""
    further_begin: float | None = None
    """Where the means of channels other than clocks and reactive power begin as setpoints, -1 to 1: at -1 sites that
    left the grid stay away until the policy has learnt to return. Their rest unless given."""
    pull: float = 1.0
    """Weight that draws means back into the actions' range."""
    max_grad_norm: float = 0.5
    """Gradients are cut to this norm."""


class Networks(torch.nn.Module):
    """Hidden layers of the actor, from a row's features, and of the critic, from those of all rows of its group."""

    def __init__(self, features: int, group: int, hidden: list[int]):
        super().__init__()
        self.group = group
        self.policy_net = torch.nn.Sequential(*create_mlp(features, -1, hidden, torch.nn.Tanh))
        self.value_net = torch.nn.Sequential(*create_mlp(group * features, -1, hidden, torch.nn.Tanh))
        self.latent_dim_pi = self.latent_dim_vf = hidden[-1]

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """(row, n_hidden)"""
        return self.policy_net(features)

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """(group, n_hidden)"""
        return self.value_net(features.reshape(-1, self.group * features.shape[-1]))


class GroupPolicy(ActorCriticPolicy):
    """SB3's actor and critic, the critic seeing all agents of an environment and giving all of them one value.

    Parameters
    ----------
    group
        Rows of an environment; observations come with all rows of an environment, one after the other.
    used
        ``JointVecEnv.used``: one row, or one a kind, told apart by the last figures of the observation, which are 1 for
        the second kind, the third .. Entries of an action that reach nothing have no likelihood.
    rest
        Where the mean of each entry of an action begins, (n_action,).
    pull
        Weight of half the squared excess of the mean over [-1, 1] in the loss: where the mean is far beyond, no action
        drawn differs in what it does, and there is nothing to learn from.
    """

    used: torch.Tensor

    def __init__(self, *args: Any, group: int, used: np.ndarray, rest: np.ndarray, pull: float, **kwargs: Any):
        self.group, self.pull = group, pull
        super().__init__(*args, **kwargs)
        self.register_buffer("used", torch.as_tensor(used))
        self.action_net.bias.data += torch.as_tensor(rest, dtype=torch.float32)  # pyright: ignore

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor: Any = Networks(self.features_dim, self.group, self.net_arch).to(self.device)  # pyright: ignore

    def used_by(self, observations: torch.Tensor) -> torch.Tensor:
        """Entries of the actions that reach the grid, (row or 1, n_action)."""
        if len(self.used) == 1:
            return self.used
        kinds = observations[:, 1 - len(self.used) :]
        return self.used[torch.where(kinds.any(-1), kinds.argmax(-1) + 1, 0)]

    def _likelihood(self, observations: torch.Tensor, actions: torch.Tensor, mean: torch.Tensor) -> torch.Tensor:
        z = (actions - mean) * torch.exp(-self.log_std)
        return (self.used_by(observations) * (-0.5 * z * z - self.log_std)).sum(-1)

    def _values(self, features: Any) -> torch.Tensor:
        return self.value_net(self.mlp_extractor.forward_critic(features)).repeat_interleave(self.group, 0)

    def sample(self, observations: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Actions drawn, (row, n_action), and their log likelihood up to a constant, (row,)."""
        mean = self.action_net(self.mlp_extractor.forward_actor(self.extract_features(observations)))
        actions = mean + torch.exp(self.log_std) * torch.randn_like(mean)
        return actions, self._likelihood(observations, actions, mean)

    def predict_values(self, obs: Any) -> torch.Tensor:
        """Value of each row, (row, 1)."""
        return self._values(self.extract_features(obs))

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Values, log likelihoods up to a constant, and the entropy up to a constant."""
        features = self.extract_features(obs)
        mean = self.action_net(self.mlp_extractor.forward_actor(features))
        if mean.requires_grad:
            beyond = (mean - mean.clamp(-1.0, 1.0)).detach() * self.used_by(obs)
            mean.register_hook(lambda gradient: gradient + self.pull / len(beyond) * beyond)
        return self._values(features), self._likelihood(obs, actions, mean), self.log_std.sum()


class GroupBuffer(RolloutBuffer):
    """A rollout whose minibatches hold whole groups: all rows of an environment at a step.

    Parameters
    ----------
    group
        Rows of an environment.
    """

    def __init__(self, *args: Any, group: int, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.group = group

    def get(self, batch_size: int | None = None) -> Generator[RolloutBufferSamples, None, None]:
        """Minibatches of about ``batch_size`` row steps, in random order."""
        arrays = (self.observations, self.actions, self.values, self.log_probs, self.advantages, self.returns)
        grouped = [torch.as_tensor(array, device=self.device) for array in arrays]
        grouped = [tensor.reshape(-1, self.group, *tensor.shape[2:]) for tensor in grouped]
        order = torch.as_tensor(np.random.permutation(len(grouped[0])), device=self.device)  # noqa: NPY002 (SB3 seeds it)
        for chosen in order.split(max(1, (batch_size or order.numel()) // self.group)):
            yield RolloutBufferSamples(*(tensor[chosen].flatten(0, 1) for tensor in grouped))


class BatchedPpo(PPO):
    """PPO that collects rollouts without a Python loop over rows."""

    def collect_rollouts(self, env: Any, callback: Any, rollout_buffer: Any, n_rollout_steps: int) -> bool:
        """Fill the buffer; the value goes on where the horizon cuts an episode off."""
        vec_env: JointVecEnv = env
        policy: Any = self.policy
        policy.set_training_mode(False)
        rollout_buffer.reset()
        callback.on_rollout_start()
        observation, starts = self._last_obs, self._last_episode_starts
        cut: list[tuple[int, np.ndarray, np.ndarray]] = []
        with torch.no_grad():
            for t in range(n_rollout_steps):
                actions, likelihood = policy.sample(self._tensor(observation))
                rollout_buffer.observations[t], rollout_buffer.episode_starts[t] = observation, starts
                rollout_buffer.actions[t] = actions.cpu().numpy()
                rollout_buffer.log_probs[t] = likelihood.cpu().numpy()
                clipped = rollout_buffer.actions[t].clip(vec_env.action_space.low, vec_env.action_space.high)  # pyright: ignore
                observation, reward, starts, _ = vec_env.step(clipped)
                rollout_buffer.rewards[t] = reward
                truncated = vec_env.truncated
                if truncated.any():
                    cut.append((t, truncated, vec_env.arrived()))
                self.num_timesteps += vec_env.num_envs
                if not callback.on_step():
                    return False
            for t, truncated, arrived in cut:
                rollout_buffer.rewards[t] += self.gamma * truncated * self._values(arrived)
            observed = rollout_buffer.observations
            values = self._values(observed.reshape(-1, observed.shape[-1]))
            rollout_buffer.values[:] = values.reshape(observed.shape[:2])
            last = policy.predict_values(self._tensor(observation))
        rollout_buffer.pos, rollout_buffer.full = n_rollout_steps, True
        rollout_buffer.compute_returns_and_advantage(last_values=last, dones=starts)
        self._last_obs, self._last_episode_starts = observation, starts  # pyright: ignore[reportAttributeAccessIssue]
        callback.on_rollout_end()
        return True

    def _tensor(self, observation: Any) -> torch.Tensor:
        return torch.as_tensor(observation, device=self.device)

    def _values(self, observation: np.ndarray) -> np.ndarray:
        return self.policy.predict_values(self._tensor(observation)).flatten().cpu().numpy()  # pyright: ignore


def make(cfg: Ppo, vec_env: JointVecEnv) -> BatchedPpo:
    """The algorithm at its beginning."""
    set_random_seed(cfg.seed)
    normalisation = sb3_models.normalise(vec_env, cfg.seed, cfg.gamma)
    rollout = vec_env.num_envs * vec_env.scenario.horizon
    rest = vec_env.rest * (cfg.outputs == "setpoint")
    if cfg.further_begin is not None:
        rest = np.where([name in ("clock", "q") for name in vec_env.channels], rest, cfg.further_begin)
    model = BatchedPpo(
        GroupPolicy,
        vec_env,
        n_steps=vec_env.scenario.horizon,
        batch_size=-(-rollout // cfg.minibatches),
        n_epochs=cfg.epochs,
        gamma=cfg.gamma,
        gae_lambda=cfg.gae_lambda,
        clip_range=cfg.clip,
        max_grad_norm=cfg.max_grad_norm,
        device=cfg.device,
        rollout_buffer_class=GroupBuffer,
        rollout_buffer_kwargs={"group": vec_env.rows_per_env},
        policy_kwargs={
            "net_arch": list(cfg.hidden),
            "log_std_init": cfg.log_std,
            **normalisation,
            "group": vec_env.rows_per_env,
            "used": vec_env.used,
            "rest": rest,
            "pull": cfg.pull,
        },
    )
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def exported(cfg: Ppo, vec_env: JointVecEnv, model: BatchedPpo) -> Policy:
    """The policy's mean as it stands, as NumPy arrays."""
    policy: Any = model.policy
    layers = [*policy.mlp_extractor.policy_net, policy.action_net]
    return sb3_models.export(
        cfg, vec_env, policy.features_extractor, layers, "tanh", "clip" if cfg.outputs == "setpoint" else "none"
    )


def main(cfg: Ppo) -> Path:
    """Train; the folder written."""
    if cfg.further_begin is not None and cfg.outputs != "setpoint":
        raise ValueError(f"further_begin is {cfg.further_begin}; leave it out, or give outputs = 'setpoint'")
    if cfg.gains is not None and not (cfg.outputs == "droop" and all(0.0 <= gain <= MOST_GAIN for gain in cfg.gains)):
        raise ValueError(f"gains is {cfg.gains}; give three from 0 to {MOST_GAIN:g}, with outputs = 'droop'")
    gains = None if cfg.gains is None else Gains(*cfg.gains)
    with sb3.begin(cfg, cfg.outputs, gains) as (run, vec_env):
        model = make(cfg, vec_env)
        return sb3.train(
            cfg, run, vec_env, model,
            iterations=max(1, round(cfg.steps / (vec_env.num_envs * vec_env.scenario.horizon))),
            exported=lambda: exported(cfg, vec_env, model),
            learning_rate=lambda done: cfg.learning_rate * (1.0 - done),
        )  # fmt: skip
