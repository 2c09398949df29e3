"""PPO in a single file, as CleanRL has it, in torch on the native batch of dcgrid.

``gymnasium.make_vec`` steps all environments by the same array operations. One whose episode ends begins the next
in the same step (``AutoresetMode.SAME_STEP``): the returned observation is the first of the new episode, and the last
of the old one is in ``infos["final_obs"]``. The horizon is not a terminal state, so the value of that last observation
belongs in the advantage; after a collapse of the power flow (``terminated``) there is none.

    python docs/examples/cleanrl_ppo.py --steps 500000 --save results/cleanrl
"""

from pathlib import Path

import gymnasium
import numpy as np
import torch
import tyro
from torch import nn
from torch.distributions import Normal

import dcgrid_env
from dcgrid_env.agents import Network, Policy
from dcgrid_env.baselines import make_controller, rollout


class Agent(nn.Module):
    """Actor and critic apart, tanh between; the logarithm of the exploration's spread is free."""

    def __init__(self, n_observation: int, n_action: int, width: int = 64):
        super().__init__()

        def layers(n_out: int, gain: float) -> nn.Sequential:
            sizes = [(n_observation, width, 2**0.5), (width, width, 2**0.5), (width, n_out, gain)]
            linear = [nn.Linear(n_in, n_next) for n_in, n_next, _ in sizes]
            for layer, (*_, g) in zip(linear, sizes, strict=True):
                nn.init.orthogonal_(layer.weight, g)
                nn.init.zeros_(layer.bias)
            return nn.Sequential(linear[0], nn.Tanh(), linear[1], nn.Tanh(), linear[2])

        self.actor, self.critic = layers(n_action, 0.01), layers(1, 1.0)
        self.log_std = nn.Parameter(torch.full((n_action,), -0.5))

    def value(self, observation: torch.Tensor) -> torch.Tensor:
        """Value of observations, (..., n_observation) to (...)."""
        return self.critic(observation).squeeze(-1)

    def distribution(self, observation: torch.Tensor) -> Normal:
        """Of actions, (..., n_action), before they are cut to [-1, 1]."""
        return Normal(self.actor(observation), self.log_std.exp())

    def policy(self) -> Policy:
        """The mean action as a policy of NumPy arrays, which dcgrid drives, saves and benchmarks without torch."""
        linear = [layer for layer in self.actor if isinstance(layer, nn.Linear)]
        arrays = [(layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy().copy()) for layer in linear]
        return Policy({"joint": Network(arrays, activation="tanh", squash="clip")}, scenario="ieee33-weak")


def tensor(array: np.ndarray) -> torch.Tensor:
    """In float32."""
    return torch.as_tensor(array, dtype=torch.float32)


def led_to(returned: np.ndarray, done: np.ndarray, infos: dict) -> torch.Tensor:
    """Observations that the actions led to: those returned, but the old episode's last where one ended."""
    last = tensor(returned).clone()
    if done.any():
        last[torch.as_tensor(done)] = tensor(np.stack(list(infos["final_obs"][done])))
    return last


def advantages(rewards, values, next_values, ended, gamma: float, gae_lambda: float) -> torch.Tensor:
    """Generalised advantage estimates; all arrays (step, row). Nothing passes from an episode to the next."""
    found, running = torch.zeros_like(rewards), torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        surprise = rewards[t] + gamma * next_values[t] - values[t]
        running = found[t] = surprise + gamma * gae_lambda * (1.0 - ended[t]) * running
    return found


def main(
    steps: int = 500_000,
    num_envs: int = 256,
    rollout_steps: int = 16,
    learning_rate: float = 1e-3,
    gamma: float = 0.5,
    gae_lambda: float = 0.95,
    epochs: int = 4,
    minibatches: int = 8,
    clip: float = 0.2,
    episodes: int = 20,
    seed: int = 0,
    save: Path | None = None,
) -> tuple[float, float]:
    """Train for so many environment steps, and give the mean J of validation episodes before and after."""
    torch.manual_seed(seed)
    envs = gymnasium.make_vec("dcgrid/IEEE33Weak-v0", num_envs=num_envs)
    n_observation, n_action = (space.shape[-1] for space in (envs.observation_space, envs.action_space))
    agent = Agent(n_observation, n_action)
    optimizer = torch.optim.Adam(agent.parameters(), lr=learning_rate, eps=1e-5)
    validation = dcgrid_env.make_scenario("ieee33-weak", split="validation")
    before = float(rollout(validation, agent.policy(), range(episodes)).costs().mean())

    shape = (rollout_steps, num_envs)
    seen, acted = torch.zeros(*shape, n_observation), torch.zeros(*shape, n_action)
    log_probs, rewards, values, next_values, ended = (torch.zeros(shape) for _ in range(5))
    observation = tensor(envs.reset(seed=seed)[0])
    updates = max(steps // (rollout_steps * num_envs), 1)
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = learning_rate * (1.0 - update / updates)
        with torch.no_grad():
            for t in range(rollout_steps):
                distribution = agent.distribution(observation)
                action = distribution.sample()
                seen[t], acted[t], values[t] = observation, action, agent.value(observation)
                log_probs[t] = distribution.log_prob(action).sum(-1)
                after_reset, reward, terminated, truncated, infos = envs.step(action.clamp(-1.0, 1.0).numpy())
                observation, rewards[t] = tensor(after_reset), tensor(reward)
                done = terminated | truncated
                next_values[t] = agent.value(led_to(after_reset, done, infos)) * ~torch.as_tensor(terminated)
                ended[t] = tensor(done)
        gained = advantages(rewards, values, next_values, ended, gamma, gae_lambda)
        flat = [x.flatten(0, 1) for x in (seen, acted, log_probs, gained, gained + values)]
        for _ in range(epochs):
            for batch in torch.randperm(rollout_steps * num_envs).chunk(minibatches):
                observed, action, old_log_prob, advantage, target = (x[batch] for x in flat)
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                distribution = agent.distribution(observed)
                ratio = (distribution.log_prob(action).sum(-1) - old_log_prob).exp()
                gain = torch.minimum(advantage * ratio, advantage * ratio.clamp(1.0 - clip, 1.0 + clip)).mean()
                value_loss = 0.5 * (agent.value(observed) - target).square().mean()
                optimizer.zero_grad()
                (0.5 * value_loss - gain).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()

    after = float(rollout(validation, agent.policy(), range(episodes)).costs().mean())
    droop = rollout(validation, make_controller("droop-tuned", validation), range(episodes)).costs().mean()
    print(f"mean J of {episodes} validation episodes: {before:.3f} before, {after:.3f} after, tuned droop {droop:.3f}")
    if save:
        agent.policy().save(save)
    return before, after


if __name__ == "__main__":
    tyro.cli(main)
