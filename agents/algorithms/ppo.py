"""Train a policy with proximal policy optimisation (PPO) on a batch of feeders.

One policy is shared by all agents (``--view shared``), or one policy controls all of them (``--view centralised``). The
implementation extends Stable-Baselines3. A rollout contains complete episodes and is collected by array operations. The
critic, used in training only, observes all agents of an environment and is evaluated once for all of them. Entries of
an action that do not reach the grid, such as an inverter's clock, do not count in the likelihood. A penalty keeps
action means within the action range, because actions outside it give no learning signal.

Every agent receives the team reward. PPO needs no grid model and supports all devices and costs. If training may use
the grid model, prefer ``ppo-counterfactual``: it scores higher on the presets where both were compared
(docs/training.md).

References: J. Schulman et al., "Proximal policy optimization algorithms", arXiv 1707.06347; C. Yu et al., "The
surprising effectiveness of PPO in cooperative multi-agent games", arXiv 2103.01955.
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
from dcgrid_env.agents.training.batched_envs import RowVecEnv
from dcgrid_env.agents.training.row_form import Outputs
from dcgrid_env.agents.training.run_folder import torch
from dcgrid_env.agents.training.setting_bounds import MOST_GAIN


@dataclass(frozen=True)
class Ppo(sb3.Config):
    """Train a policy with PPO."""

    outputs: Outputs = "setpoint"
    """Network outputs: set points, changes from the action that keeps the current state, or corrections of a droop."""
    gains: tuple[float, float, float] | None = None
    """Gains for --outputs droop: k_p in MW/p.u., k_q in Mvar/(p.u. s), alpha in 1/s. Default: the tuned droop's."""
    steps: int = 10_000_000
    """Total number of steps: agent steps with a shared policy, environment steps with a centralised one."""
    gae_lambda: float = 0.8
    """Decay lambda of generalised advantage estimation."""
    learning_rate: float = 3e-3
    """Initial learning rate; it decays linearly to zero."""
    epochs: int = 3
    """Number of passes over each rollout."""
    minibatches: int = 8
    """Number of minibatches in each pass."""
    clip: float = 0.2
    """Clip range of the likelihood ratio."""
    log_std: float = -0.7
    """Logarithm of the initial standard deviation of exploration."""
    further_begin: float | None = None
    """Initial mean, -1 to 1, of channels other than clock and reactive power, with --outputs setpoint. At -1,
    disconnected sites stay disconnected until the policy has learned to reconnect. Default: the channel's rest
    value."""
    pull: float = 1.0
    """Weight of the penalty on action means outside the action range."""
    max_grad_norm: float = 0.5
    """Maximum norm of the gradient; larger gradients are scaled down."""

    with_difference = sb3.Config.with_difference | {
        "gae_lambda": 0.0, "outputs": "change", "log_std": -1.0, "steps": 3_000_000,
    }  # fmt: skip


class Networks(torch.nn.Module):
    """Store the hidden layers of actor and critic.

    The actor uses the features of a row, the critic those of all rows of its group.
    """

    def __init__(self, features: int, group: int, hidden: list[int]):
        super().__init__()
        self.group = group
        self.policy_net = torch.nn.Sequential(*create_mlp(features, -1, hidden, torch.nn.Tanh))
        self.value_net = torch.nn.Sequential(*create_mlp(group * features, -1, hidden, torch.nn.Tanh))
        self.latent_dim_pi = self.latent_dim_vf = [features, *hidden][-1]

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """(row, n_hidden)"""
        return self.policy_net(features)

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """(group, n_hidden)"""
        return self.value_net(features.reshape(-1, self.group * features.shape[-1]))


class GroupPolicy(ActorCriticPolicy):
    """Extend the actor and critic of SB3 with a critic that computes one value for all agents of an environment.

    Parameters
    ----------
    group
        Number of rows of an environment. The rows of an environment are consecutive.
    used
        ``Rows.used``: one row, or one row for each kind of agent. The last entries of the observation are a
        one-hot code of the kind, all zero for the first kind. Unused entries of an action have no likelihood.
    rest
        Initial mean of each entry of an action, (n_action,).
    pull
        Weight of half the squared excess of the mean over [-1, 1] in the loss. If the mean is far outside this range,
        all sampled actions have the same effect, which gives no learning signal.
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
        """Return which entries of the actions reach the grid, (row or 1, n_action)."""
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
        """Sample actions, (row, n_action), and return them with their log likelihood up to a constant, (row,)."""
        mean = self.action_net(self.mlp_extractor.forward_actor(self.extract_features(observations)))
        actions = mean + torch.exp(self.log_std) * torch.randn_like(mean)
        return actions, self._likelihood(observations, actions, mean)

    def predict_values(self, obs: Any) -> torch.Tensor:
        """Return the value of each row, (row, 1)."""
        return self._values(self.extract_features(obs))

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return values, log likelihoods up to a constant, and the entropy up to a constant."""
        features = self.extract_features(obs)
        mean = self.action_net(self.mlp_extractor.forward_actor(features))
        if mean.requires_grad:
            beyond = (mean - mean.clamp(-1.0, 1.0)).detach() * self.used_by(obs)
            mean.register_hook(lambda gradient: gradient + self.pull / len(beyond) * beyond)
        return self._values(features), self._likelihood(obs, actions, mean), self.log_std.sum()


class GroupBuffer(RolloutBuffer):
    """Store a rollout and sample minibatches of complete groups: all rows of an environment at a step.

    Parameters
    ----------
    group
        Number of rows of an environment.
    """

    def __init__(self, *args: Any, group: int, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.group = group

    def get(self, batch_size: int | None = None) -> Generator[RolloutBufferSamples, None, None]:
        """Yield minibatches of about ``batch_size`` row steps, in random order."""
        arrays = (self.observations, self.actions, self.values, self.log_probs, self.advantages, self.returns)
        grouped = [torch.as_tensor(array, device=self.device) for array in arrays]
        grouped = [tensor.reshape(-1, self.group, *tensor.shape[2:]) for tensor in grouped]
        order = torch.as_tensor(np.random.permutation(len(grouped[0])), device=self.device)  # noqa: NPY002 (SB3 seeds it)
        for chosen in order.split(max(1, (batch_size or order.numel()) // self.group)):
            yield RolloutBufferSamples(*(tensor[chosen].flatten(0, 1) for tensor in grouped))


class BatchedPpo(PPO):
    """Run PPO and collect rollouts without a Python loop over rows."""

    def collect_rollouts(self, env: Any, callback: Any, rollout_buffer: Any, n_rollout_steps: int) -> bool:
        """Fill the buffer; bootstrap the value where the horizon truncates an episode."""
        vec_env: RowVecEnv = env
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


def make(cfg: Ppo, vec_env: RowVecEnv) -> BatchedPpo:
    """Return the initialised algorithm."""
    set_random_seed(cfg.seed)
    normalisation = sb3_models.normalise(vec_env, cfg.seed, cfg.gamma)
    rollout = vec_env.num_envs * vec_env.scenario.horizon
    rest = vec_env.rows.rest * (cfg.outputs == "setpoint")
    if cfg.further_begin is not None:
        rest = np.where([name in ("clock", "q") for name in vec_env.rows.channels], rest, cfg.further_begin)
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
            "used": vec_env.rows.used,
            "rest": rest,
            "pull": cfg.pull,
        },
    )
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def exported(cfg: Ppo, vec_env: RowVecEnv, model: BatchedPpo) -> Policy:
    """Return the mean of the current policy as NumPy arrays."""
    policy: Any = model.policy
    layers = [*policy.mlp_extractor.policy_net, policy.action_net]
    return sb3_models.export(
        cfg, vec_env, policy.features_extractor, layers, "tanh", "clip" if cfg.outputs == "setpoint" else "none"
    )


def main(cfg: Ppo) -> Path:
    """Train a policy and return the output folder."""
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
