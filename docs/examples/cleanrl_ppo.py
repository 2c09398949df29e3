"""PPO in a single file, in the style of CleanRL, on the rows of ``training_env``.

A row is a channel of an agent, and an action of 0 is no control. Difference rewards pay a row in each step
for what its action saves, later costs included. The discount is therefore 0: an advantage is the reward less the value.

    python docs/examples/cleanrl_ppo.py --save results/cleanrl
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from torch import nn
from torch.distributions import Normal

import dcgrid_env
from dcgrid_env.agents import Network, Policy, policy_of_rows, training_env

SCENARIO = "ieee33-weak"


class Agent(nn.Module):
    """Actor and critic, separate; the logarithm of the exploration's spread is free."""

    def __init__(self, envs: Any):
        super().__init__()
        (n_observation,), (n_action,) = envs.single_observation_space.shape, envs.single_action_space.shape

        def layers(n_out: int, gain: float) -> nn.Sequential:
            linear = [nn.Linear(n_observation, 64), nn.Linear(64, 64), nn.Linear(64, n_out)]
            for layer, layer_gain in zip(linear, (2**0.5, 2**0.5, gain), strict=True):
                nn.init.orthogonal_(layer.weight, layer_gain)
                nn.init.zeros_(layer.bias)
            return nn.Sequential(linear[0], nn.Tanh(), linear[1], nn.Tanh(), linear[2])

        self.actor, self.critic = layers(n_action, 0.01), layers(1, 1.0)
        self.log_std = nn.Parameter(torch.full((n_action,), -1.0))

    def value(self, observation: torch.Tensor) -> torch.Tensor:
        """Value of observations, (..., n_observation) to (...)."""
        return self.critic(observation).squeeze(-1)

    def distribution(self, observation: torch.Tensor) -> Normal:
        """Distribution of actions, (..., n_action), before they are clipped to [-1, 1]."""
        return Normal(self.actor(observation), self.log_std.exp())

    def policy(self, envs: Any) -> Policy:
        """Return the mean action as a policy of NumPy arrays, which dcgrid runs without torch."""
        linear = [layer for layer in self.actor if isinstance(layer, nn.Linear)]
        arrays = [(layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy().copy()) for layer in linear]
        clip = float(envs.single_observation_space.high[0])
        network = Network(arrays, "tanh", "clip", envs.scaling.mean, envs.scaling.std, clip)
        return policy_of_rows(envs.rows, network, scenario=envs.scenario.name)


def tensor(array: np.ndarray) -> torch.Tensor:
    """In float32."""
    return torch.as_tensor(array, dtype=torch.float32)


def train(agent: Agent, envs: Any, updates: int, seed: int, before_update: Callable[[float], None]) -> None:
    """Train an agent; ``before_update`` is called with the share of updates done."""
    optimizer = torch.optim.Adam(agent.parameters(), lr=3e-3, eps=1e-5)
    observation, horizon = tensor(envs.reset(seed=seed)[0]), envs.unwrapped.scenario.horizon
    for update in range(updates):
        before_update(update / updates)
        optimizer.param_groups[0]["lr"] = 3e-3 * (1.0 - update / updates)
        steps = []
        for _ in range(horizon):
            with torch.no_grad():
                distribution = agent.distribution(observation)
                action = distribution.sample()
                log_prob = distribution.log_prob(action).sum(-1)
            after, reward, *_ = envs.step(action.numpy())
            steps.append((observation, action, log_prob, tensor(reward)))
            observation = tensor(after)
        flat = [torch.cat(each) for each in zip(*steps, strict=True)]
        for _ in range(3):
            for batch in torch.randperm(len(flat[0])).chunk(8):
                observed, action, old_log_prob, reward = (x[batch] for x in flat)
                value = agent.value(observed)
                advantage = (reward - value).detach()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                ratio = (agent.distribution(observed).log_prob(action).sum(-1) - old_log_prob).exp()
                gain = torch.minimum(advantage * ratio, advantage * ratio.clamp(0.8, 1.2)).mean()
                optimizer.zero_grad()
                (0.5 * (value - reward).square().mean() - gain).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()


def main(
    steps: int = 100_000, num_envs: int = 32, episodes: int = 32, seed: int = 0, save: Path | None = None
) -> float:
    """Train for a number of environment steps, and return the score on test episodes."""
    torch.set_num_threads(1)  # more threads slow down networks of this size
    torch.manual_seed(seed)
    envs = training_env(SCENARIO, num_envs)
    agent = Agent(envs)
    train(agent, envs, max(1, steps // (num_envs * envs.scenario.horizon)), seed, lambda share: None)
    result = dcgrid_env.score(agent.policy(envs), SCENARIO, range(episodes))
    print(result)
    if save:
        agent.policy(envs).save(save)
    return result.score.value


if __name__ == "__main__":
    tyro.cli(main)
