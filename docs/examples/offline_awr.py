"""Behaviour cloning and advantage-weighted regression from data alone, in torch: a network for each kind of agent.

X. B. Peng et al., "Advantage-weighted regression: simple and scalable off-policy reinforcement learning", arXiv
1910.00177. A critic learns what joint observations are worth under the behaviour, from the returns in the data; the
actors, which see their own bus alone, copy the actions of the data, those most that turned out better than that:

    loss = w |pi(s) - a|^2        w = exp(advantage / temperature), cut at 20        no temperature is behaviour cloning

What an action is worth is small beside what the load does meanwhile, and a critic hardly tells the two apart. Where
several behaviours ran through the same episodes, ``--paired`` needs none: the load is the same for all, and what a
behaviour's return from a step on is above their mean is due to what they did.

Nothing is asked of actions that the data do not hold, which is why it cannot go astray far, nor far beyond the data.

    dcgrid dataset --controller droop-tuned --noise 0.3 --episodes 1000
    python docs/examples/offline_awr.py dcgrid/ieee33-weak/droop-tuned-noise-0_3-v0 --save results/offline

Data sets stand in the folder that MINARI_DATASETS_PATH names, else in results/datasets. The policy that is kept is the
one of the best validation J; the test split is not looked at.
"""

import os
import shlex
import sys
import time
from itertools import pairwise
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
    """Episodes of data sets of one scenario, joint, and where each agent stands in them; (episode, step, n) arrays."""

    def __init__(self, ids: list[str]):
        root = Path(os.environ.get("MINARI_DATASETS_PATH") or "results/datasets")
        sets = [minari.MinariDataset(root / name / "data") for name in ids]
        about = sets[0].storage.metadata
        if any(one.storage.metadata["env_spec"] != about["env_spec"] for one in sets):
            raise ValueError(f"{', '.join(ids)} are of different scenarios; learn from data sets of one")
        self.scenario: Scenario = sets[0].recover_environment().unwrapped.scenario  # pyright: ignore
        episodes = [episode for one in sets for episode in one]
        if any(len(episode) != self.scenario.horizon for episode in episodes):
            raise ValueError(f"{', '.join(ids)} hold episodes that ended in voltage collapse; leave these out")
        self.observation, self.action, self.reward = (
            torch.as_tensor(np.stack([getattr(episode, name) for episode in episodes]), dtype=torch.float32)
            for name in ("observations", "actions", "rewards")
        )
        self.seed = np.array([about["seed"] for s in sets for about in s.storage.get_episode_metadata(range(len(s)))])
        self.agents: dict[str, list[dict[str, Any]]] = {}
        for agent in about["agents"].values():
            self.agents.setdefault(agent["kind"], []).append(agent)

    def of_kind(self, kind: str) -> tuple[torch.Tensor, torch.Tensor]:
        """Own observations and actions of the agents of a kind, (step of all episodes, agent, n) each."""
        seen, acted = self.observation[:, :-1].flatten(0, 1), self.action.flatten(0, 1)
        own = self.agents[kind]
        return (
            torch.stack([seen[:, slice(*agent["observation"])] for agent in own], dim=1),
            torch.stack([acted[:, slice(*agent["action"])] for agent in own], dim=1),
        )


class Perceptron(nn.Module):
    """Two hidden layers on the normalised input."""

    def __init__(self, like: torch.Tensor, n_out: int, width: int):
        super().__init__()
        self.mean, self.std = like.mean(0), like.std(0).clamp_min(1e-3)
        sizes = (like.shape[-1], width, width, n_out)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Output, (..., n_out)."""
        x = (x - self.mean) / self.std
        for layer in self.layers[:-1]:
            x = torch.relu(layer(x))
        return self.layers[-1](x)

    def exported(self) -> Network:
        """The same in NumPy, its output through tanh."""
        layers = [(layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in self.layers]  # pyright: ignore
        mean, std = self.mean.numpy(), self.std.numpy()
        return Network(layers, activation="relu", squash="tanh", mean=mean, std=std)


def returns(reward: torch.Tensor, value: torch.Tensor, gamma: float, trace: float) -> torch.Tensor:
    """TD(lambda) returns, (episode, T), of rewards (episode, T) and values (episode, T + 1).

    The horizon is not a terminal state: the value of the last observation counts.
    """
    found, running = torch.empty_like(reward), value[:, -1]
    for t in reversed(range(reward.shape[1])):
        running = found[:, t] = reward[:, t] + gamma * ((1.0 - trace) * value[:, t + 1] + trace * running)
    return found


def compared(data: Data, reward: torch.Tensor, gamma: float) -> torch.Tensor:
    """How much better each step and what came after turned out than the mean of the same seed's episodes in the data.

    (step of all episodes,); ValueError for an episode that only one behaviour ran through.
    """
    to_go = returns(reward, torch.zeros(len(reward), reward.shape[1] + 1), gamma, 1.0)
    _, which, count = np.unique(data.seed, return_inverse=True, return_counts=True)
    if count.min() < 2:
        raise ValueError(
            f"seed {data.seed[count[which].argmin()]} stands in the data once; pair data sets of one --seed"
        )
    place = torch.as_tensor(which)
    mean = torch.zeros(len(count), to_go.shape[1]).index_add_(0, place, to_go) / torch.as_tensor(count)[:, None]
    return (to_go - mean[place]).flatten()


def judged(data: Data, reward: torch.Tensor, cfg: dict[str, Any]) -> torch.Tensor:
    """How much better each step's joint action turned out than what the behaviour does, (step of all episodes,)."""
    critic = Perceptron(data.observation.flatten(0, 1), 1, cfg["width"])
    optimiser = torch.optim.Adam(critic.parameters(), lr=cfg["learning_rate"])
    seen = data.observation[:, :-1].flatten(0, 1)
    for done in range(cfg["rounds"]):
        with torch.no_grad():
            target = returns(reward, critic(data.observation).squeeze(-1), cfg["gamma"], cfg["trace"]).flatten()
        for rows in torch.randperm(len(seen)).split(cfg["batch"]):
            optimiser.zero_grad()
            loss = (critic(seen[rows]).squeeze(-1) - target[rows]).square().mean()
            loss.backward()
            optimiser.step()
        explained = 1.0 - float(loss.detach()) / float(target.var())
        print(f"critic, round {done + 1}: {explained:.3f} of the variance explained")
    with torch.no_grad():
        value = critic(data.observation).squeeze(-1)
        return (returns(reward, value, cfg["gamma"], cfg["advantage_trace"]) - value[:, :-1]).flatten()


def main(
    datasets: tyro.conf.Positional[list[str]],
    temperature: float | None = 0.5,
    rounds: int = 25,
    epochs: int = 9,
    batch: int = 2048,
    learning_rate: float = 1e-3,
    paired: bool = False,
    gamma: float = 0.9,
    trace: float = 0.9,
    advantage_trace: float = 0.0,
    width: int = 64,
    validate_every: int = 1,
    episodes: int = 20,
    seed: int = 0,
    save: Path | None = None,
) -> tuple[float, float]:
    """Learn from data sets, and give the mean J of the validation episodes under the policy and the tuned droop.

    ``temperature`` is a share of the advantages' standard deviation; ``None`` clones. ``paired`` takes no critic but
    data sets of several behaviours in the same episodes, and holds each against the others.
    """
    torch.manual_seed(seed)
    begun, data = time.monotonic(), Data(datasets)
    cfg = {"width": 2 * width, "rounds": rounds, "batch": batch, "learning_rate": learning_rate}
    cfg |= {"gamma": gamma, "trace": trace, "advantage_trace": advantage_trace}
    weight = torch.ones(data.reward.numel())
    if temperature is not None:
        reward = data.reward / data.reward.std().clamp_min(1e-6)
        advantage = compared(data, reward, gamma) if paired else judged(data, reward, cfg)
        weight = (advantage / (temperature * advantage.std())).exp().clamp(max=20.0)
        weight /= weight.mean()

    parts = {kind: data.of_kind(kind) for kind in data.agents}
    actors = {k: Perceptron(seen.flatten(0, 1), acted.shape[-1], width) for k, (seen, acted) in parts.items()}
    optimiser = torch.optim.Adam([p for actor in actors.values() for p in actor.parameters()], lr=learning_rate)
    validation = data.scenario.replace(split="validation")
    best, kept = np.inf, None
    for epoch in range(1, epochs + 1):
        optimiser.param_groups[0]["lr"] = learning_rate * (1.0 - (epoch - 1) / epochs)
        for rows in torch.randperm(len(weight)).split(batch):
            optimiser.zero_grad()
            loss = torch.zeros(())
            for kind, (seen, acted) in parts.items():
                error = (torch.tanh(actors[kind](seen[rows])) - acted[rows]).square().sum((-1, -2))
                loss = loss + (weight[rows] * error).mean()
            loss.backward()
            optimiser.step()
        if epoch % validate_every == 0 or epoch == epochs:
            networks = {kind: actor.exported() for kind, actor in actors.items()}
            policy = Policy(networks, scenario=data.scenario.name, made_with=shlex.join(["python", *sys.argv]))
            found = evaluate(policy, validation, range(episodes)).means["J"]
            print(f"epoch {epoch}: validation J {found:.4f}")
            if found < best:
                best, kept = found, policy

    droop = evaluate(find_controller("droop-tuned", validation), validation, range(episodes)).means["J"]
    print(f"mean J of {episodes} validation episodes: {best:.3f}, tuned droop {droop:.3f}")
    if save and kept:
        algorithm = "behaviour-cloning" if temperature is None else "awr"
        card = {"algorithm": algorithm, "seed": seed, "training_s": time.monotonic() - begun, "validation_J": best}
        kept.save(save, card)
    return best, droop


if __name__ == "__main__":
    tyro.cli(main)
