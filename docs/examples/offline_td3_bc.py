"""Behaviour cloning and TD3+BC from data alone, in torch: one network for each kind of agent, on its own observation.

S. Fujimoto and S. S. Gu, "A minimalist approach to offline reinforcement learning", arXiv 2106.06860. Two critics judge
the joint action; the actors, which see their own bus alone, go where the critics say and stay near the data:

    loss = -alpha / mean |Q| * Q(s, pi(s)) + |pi(s) - a|^2          alpha = 0 is behaviour cloning

    dcgrid dataset --controller droop-tuned --noise 0.2 --episodes 500
    python docs/examples/offline_td3_bc.py dcgrid/ieee33-weak/droop-tuned-noise-0_2-v0 --save results/offline

Data sets stand in the folder that MINARI_DATASETS_PATH names, else in results/datasets. The policy that is kept is the
one of the best validation J; the test split is not looked at.
"""

import copy
import os
import shlex
import sys
import time
from pathlib import Path
from typing import Any

import minari
import numpy as np
import torch
import tyro
from torch import nn

from dcgrid_env import Scenario
from dcgrid_env.agents import Network, Policy, evaluate, find_controller


class Data:
    """Transitions of data sets of one scenario, joint, and where each agent stands in them."""

    def __init__(self, ids: list[str]):
        root = Path(os.environ.get("MINARI_DATASETS_PATH") or "results/datasets")
        sets = [minari.MinariDataset(root / name / "data") for name in ids]
        made_of = sets[0].storage.metadata
        if any(one.storage.metadata["env_spec"] != made_of["env_spec"] for one in sets):
            raise ValueError(f"{', '.join(ids)} are of different scenarios; learn from data sets of one")
        self.agents: dict[str, dict[str, Any]] = made_of["agents"]
        self.scenario: Scenario = sets[0].recover_environment().unwrapped.scenario  # pyright: ignore
        episodes = [episode for one in sets for episode in one]
        self.observation = joined([episode.observations[:-1] for episode in episodes])
        self.following = joined([episode.observations[1:] for episode in episodes])
        self.action = joined([episode.actions for episode in episodes])
        self.reward = joined([episode.rewards for episode in episodes])
        # The horizon is not a terminal state, so that the value of the last observation counts; a collapse is one.
        self.goes_on = 1.0 - joined([episode.terminations for episode in episodes])

    def kinds(self) -> dict[str, list[dict[str, Any]]]:
        """Where the agents of each kind stand."""
        found: dict[str, list[dict[str, Any]]] = {}
        for agent in self.agents.values():
            found.setdefault(agent["kind"], []).append(agent)
        return found


def joined(arrays: list[np.ndarray]) -> torch.Tensor:
    """Arrays one after the other, in float32."""
    return torch.as_tensor(np.concatenate(arrays), dtype=torch.float32)


def perceptron(n_in: int, n_out: int, width: int) -> nn.Sequential:
    """Two hidden layers."""
    return nn.Sequential(nn.Linear(n_in, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, n_out))


class Actor(nn.Module):
    """One network for all agents of a kind, from an agent's own normalised observation to its own action."""

    def __init__(self, data: Data, width: int):
        super().__init__()
        self.kinds = data.kinds()
        self.n_action = data.action.shape[-1]
        own = {kind: self.of_agents(kind, data.observation, "observation").flatten(0, 1) for kind in self.kinds}
        self.mean = {kind: seen.mean(0) for kind, seen in own.items()}
        self.std = {kind: seen.std(0).clamp_min(1e-3) for kind, seen in own.items()}
        acts = {kind: len(agents[0]["channels"]) for kind, agents in self.kinds.items()}
        self.networks = nn.ModuleDict({kind: perceptron(len(self.mean[kind]), n, width) for kind, n in acts.items()})

    def of_agents(self, kind: str, joint: torch.Tensor, what: str) -> torch.Tensor:
        """The agents' parts of a joint observation or action, (row, agent, n)."""
        return torch.stack([joint[..., slice(*agent[what])] for agent in self.kinds[kind]], dim=-2)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Joint action, (row, n_action), in [-1, 1]."""
        joint: list[torch.Tensor] = [torch.empty(0)] * self.n_action
        for kind, network in self.networks.items():
            seen = (self.of_agents(kind, observation, "observation") - self.mean[kind]) / self.std[kind]
            acted = torch.tanh(network(seen))
            for i, agent in enumerate(self.kinds[kind]):
                for channel, entry in enumerate(range(*agent["action"])):
                    joint[entry] = acted[..., i, channel]
        return torch.stack(joint, dim=-1)

    def policy(self, scenario: str) -> Policy:
        """The actor as a policy of NumPy arrays, which dcgrid drives, saves and scores without torch."""
        networks = {}
        for kind, network in self.networks.items():
            linear = [layer for layer in network if isinstance(layer, nn.Linear)]  # pyright: ignore
            layers = [(part.weight.detach().numpy().T.copy(), part.bias.detach().numpy().copy()) for part in linear]
            mean, std = self.mean[kind].numpy(), self.std[kind].numpy()
            networks[kind] = Network(layers, activation="relu", squash="tanh", mean=mean, std=std)
        return Policy(networks, scenario=scenario, made_with=shlex.join(["python", *sys.argv]))


class Critic(nn.Module):
    """Two estimates of what a joint action is worth, from the joint observation."""

    def __init__(self, data: Data, width: int):
        super().__init__()
        self.mean, self.std = data.observation.mean(0), data.observation.std(0).clamp_min(1e-3)
        n_in = data.observation.shape[-1] + data.action.shape[-1]
        self.estimates = nn.ModuleList(perceptron(n_in, 1, width) for _ in range(2))

    def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Both, (2, row)."""
        seen = torch.cat([(observation - self.mean) / self.std, action], dim=-1)
        return torch.stack([estimate(seen).squeeze(-1) for estimate in self.estimates])


def follow(target: nn.Module, network: nn.Module, rate: float) -> None:
    """Move a target network a little towards the one that learns."""
    with torch.no_grad():
        for slow, fast in zip(target.parameters(), network.parameters(), strict=True):
            slow.lerp_(fast, rate)


def main(
    datasets: tyro.conf.Positional[list[str]],
    alpha: float = 2.5,
    updates: int = 20_000,
    batch: int = 256,
    learning_rate: float = 1e-3,
    gamma: float = 0.9,
    target_rate: float = 0.005,
    target_noise: float = 0.1,
    actor_every: int = 2,
    width: int = 64,
    critic_width: int = 128,
    validate_every: int = 2_000,
    episodes: int = 20,
    seed: int = 0,
    save: Path | None = None,
) -> tuple[float, float]:
    """Learn from data sets, and give the mean J of the validation episodes under the policy and the tuned droop."""
    torch.manual_seed(seed)
    begun = time.monotonic()
    data = Data(datasets)
    reward = data.reward / data.reward.std().clamp_min(1e-6)
    actor, critic = Actor(data, width), Critic(data, critic_width)
    slow_actor, slow_critic = copy.deepcopy(actor), copy.deepcopy(critic)
    of_actor = torch.optim.Adam(actor.parameters(), lr=learning_rate)
    of_critic = torch.optim.Adam(critic.parameters(), lr=learning_rate)

    validation = data.scenario.replace(split="validation")
    best, kept = np.inf, actor.policy(data.scenario.name)
    for update in range(1, updates + 1):
        for optimiser in (of_actor, of_critic):
            optimiser.param_groups[0]["lr"] = learning_rate * (1.0 - (update - 1) / updates)
        rows = torch.randint(len(reward), (batch,))
        seen, acted, after = data.observation[rows], data.action[rows], data.following[rows]
        if alpha > 0.0:
            with torch.no_grad():
                noise = (target_noise * torch.randn_like(acted)).clamp(-0.5, 0.5)
                chosen = (slow_actor(after) + noise).clamp(-1.0, 1.0)
                target = reward[rows] + gamma * data.goes_on[rows] * slow_critic(after, chosen).amin(0)
            of_critic.zero_grad()
            (critic(seen, acted) - target).square().mean(-1).sum().backward()
            of_critic.step()
        if update % actor_every == 0:
            chosen = actor(seen)
            loss = (chosen - acted).square().mean()
            if alpha > 0.0:
                worth = critic(seen, chosen)[0]
                loss = loss - alpha * worth.mean() / worth.abs().mean().detach()
            of_actor.zero_grad()
            loss.backward()
            of_actor.step()
            follow(slow_actor, actor, target_rate)
            follow(slow_critic, critic, target_rate)
        if update % validate_every == 0 or update == updates:
            policy = actor.policy(data.scenario.name)
            found = evaluate(policy, validation, range(episodes)).means["J"]
            print(f"{update:>7} updates: validation J {found:.4f}")
            if found < best:
                best, kept = found, policy

    droop = evaluate(find_controller("droop-tuned", validation), validation, range(episodes)).means["J"]
    print(f"mean J of {episodes} validation episodes: {best:.3f}, tuned droop {droop:.3f}")
    if save:
        algorithm = "td3-bc" if alpha > 0.0 else "behaviour-cloning"
        card = {"algorithm": algorithm, "seed": seed, "training_s": time.monotonic() - begun, "validation_J": best}
        kept.save(save, card)
    return best, droop


if __name__ == "__main__":
    tyro.cli(main)
