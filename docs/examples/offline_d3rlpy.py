"""CQL, IQL, TD3+BC and behaviour cloning of d3rlpy on a data set of dcgrid.

A transition is one agent's own observation, action and reward in a step, and the agents of a kind share one network.
``--reward difference`` (default) uses each agent's difference reward, which needs no discount; the data set must then
be made with ``--set reward=difference``. ``--reward team`` uses the cost of the whole feeder for every agent.

    dcgrid dataset --controller droop-tuned,analytic,random --noise 0.1 --set reward=difference --name mixed
    python docs/examples/offline_d3rlpy.py dcgrid/ieee33-weak/mixed-v0 --algorithm td3-bc --save results/offline/td3-bc

The folder of the data sets is MINARI_DATASETS_PATH, or results/datasets. Training uses the data alone, and the last
policy is kept. The validation episodes are only used to print J.

References: A. Kumar et al., "Conservative Q-learning for offline reinforcement learning", arXiv 2006.04779;
I. Kostrikov et al., "Offline reinforcement learning with implicit Q-learning", arXiv 2110.06169; S. Fujimoto and
S. Gu, "A minimalist approach to offline reinforcement learning", arXiv 2106.06860; T. Seno and M. Imai, "d3rlpy: an
offline deep reinforcement learning library", Journal of Machine Learning Research 23, 2022.
"""

import os
import shlex
import sys
import time
from pathlib import Path
from typing import Any, Literal

import d3rlpy
import minari
import numpy as np
import torch
import tyro
from d3rlpy.algos import BCConfig, CQLConfig, IQLConfig, TD3PlusBCConfig
from d3rlpy.dataset import MDPDataset
from d3rlpy.models import VectorEncoderFactory
from d3rlpy.preprocessing import ClipRewardScaler, StandardObservationScaler, StandardRewardScaler

from dcgrid_env import Scenario
from dcgrid_env.agents import Network, Policy, evaluate, find_controller

Algorithm = Literal["cql", "iql", "td3-bc", "bc"]
Reward = Literal["difference", "team"]


class Data:
    """The episodes of a data set by agent.

    Parameters
    ----------
    name
        Id of the data set.
    reward
        "difference": the sum of the agent's entries of ``reward_vector``. "team": minus the cost of the feeder.
    """

    def __init__(self, name: str, reward: Reward):
        root = Path(os.environ.get("MINARI_DATASETS_PATH") or "results/datasets")
        dataset = minari.MinariDataset(root / name / "data")
        self.scenario: Scenario = dataset.recover_environment().unwrapped.scenario  # pyright: ignore
        self.reward, self.episodes = reward, list(dataset)
        self.agents: dict[str, list[dict[str, Any]]] = {}
        for agent in dataset.storage.metadata["agents"].values():
            self.agents.setdefault(agent["kind"], []).append(agent)
        if reward == "difference" and self.scenario.cost.reward != "difference":
            raise ValueError(
                f"reward: the data set {name!r} has no difference rewards; write it with --set reward=difference, "
                "or choose --reward team"
            )

    def of_kind(self, kind: str) -> MDPDataset:
        """Return the transitions of all agents of a kind, one d3rlpy episode for each agent and episode."""
        parts: list[tuple[np.ndarray, ...]] = []
        for episode in self.episodes:
            infos: Any = episode.infos
            team = -sum(values[1:] for name, values in infos.items() if name.startswith("cost_"))
            for agent in self.agents[kind]:
                seen, acted = slice(*agent["observation"]), slice(*agent["action"])
                paid = team if self.reward == "team" else infos["reward_vector"][1:, acted].sum(-1)
                terminals, timeouts = episode.terminations, episode.truncations
                observed = episode.observations[:-1, seen]
                parts.append((observed, episode.actions[:, acted], paid[:, None], terminals, timeouts))
        observations, actions, rewards, terminals, timeouts = map(np.concatenate, zip(*parts, strict=True))
        return MDPDataset(observations, actions, rewards.astype(np.float32), terminals, timeouts)


BALANCE = {"cql": "conservative_weight", "iql": "weight_temp", "td3-bc": "alpha"}
"""The setting of each algorithm that balances the learned values against the actions in the data."""


def learner(algorithm: Algorithm, reward: Reward, rate: float, balance: float | None, **common: Any) -> Any:
    """Return an algorithm of d3rlpy with its default settings except for these.

    Difference rewards are clipped to [-1, 1], because a few steps with violations have far larger ones than the others.
    """
    encoder = common.pop("encoder")
    common["observation_scaler"] = StandardObservationScaler()
    if algorithm == "bc":
        return BCConfig(learning_rate=rate, encoder_factory=encoder, **common).create()
    kinds: dict[str, Any] = {"cql": CQLConfig, "iql": IQLConfig, "td3-bc": TD3PlusBCConfig}
    common["reward_scaler"] = ClipRewardScaler(-1.0, 1.0) if reward == "difference" else StandardRewardScaler()
    common |= {"actor_learning_rate": rate, "critic_learning_rate": rate}
    common |= {"actor_encoder_factory": encoder, "critic_encoder_factory": encoder}
    if algorithm == "iql":
        common["value_encoder_factory"] = encoder
    if balance is not None:
        common[BALANCE[algorithm]] = balance
    return kinds[algorithm](**common).create()


def exported(model: Any) -> Network:
    """Return the greedy policy of a trained algorithm in NumPy."""
    modules = model.impl.modules
    policy = getattr(modules, "policy", None) or modules.imitator
    linear = [layer for layer in policy._encoder.modules() if isinstance(layer, torch.nn.Linear)]
    linear.append(policy._mu if hasattr(policy, "_mu") else policy._fc)
    layers = [(layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in linear]
    scaler = model.config.observation_scaler
    mean, std = (np.asarray(values, np.float32) for values in (scaler.mean, scaler.std + scaler.eps))
    return Network(layers, activation="relu", squash="tanh", mean=mean, std=std)


def main(
    dataset: tyro.conf.Positional[str],
    algorithm: Algorithm = "td3-bc",
    reward: Reward = "difference",
    steps: int = 1000,
    batch: int = 256,
    learning_rate: float = 1e-3,
    gamma: float | None = None,
    balance: float | None = None,
    width: int = 64,
    episodes: int = 20,
    seed: int = 0,
    save: Path | None = None,
) -> tuple[float, float]:
    """Learn from a data set, and return the mean J of validation episodes of the policy and of the tuned droop.

    Parameters
    ----------
    dataset
        Id of the data set.
    algorithm
        "cql", "iql", "td3-bc" or "bc" (behaviour cloning).
    reward
        Reward of an agent: its difference reward, or the team's.
    steps
        Gradient steps for each kind of agent.
    batch
        Transitions in a minibatch.
    learning_rate
        Learning rate of all networks.
    gamma
        Discount factor. Default: 0 for difference rewards, 0.9 for the team's.
    balance
        conservative_weight of CQL, weight_temp of IQL or alpha of TD3+BC. Default: d3rlpy's.
    width
        Units of each hidden layer.
    episodes
        Validation episodes.
    seed
        Random seed.
    save
        File for the policy, without suffix.
    """
    if algorithm == "bc" and balance is not None:
        raise ValueError(f"balance: must not be given for bc, got {balance}; remove --balance")
    begun, began_cpu = time.monotonic(), time.process_time()
    torch.set_num_threads(1)  # more threads slow down networks of this size
    d3rlpy.seed(seed)
    data = Data(dataset, reward)
    gamma = (0.0 if reward == "difference" else 0.9) if gamma is None else gamma
    quiet: dict[str, Any] = {"logger_adapter": d3rlpy.logging.NoopAdapterFactory(), "show_progress": False}
    common: dict[str, Any] = {"batch_size": batch, "gamma": gamma, "encoder": VectorEncoderFactory([width, width])}
    networks = {}
    for kind in data.agents:
        model = learner(algorithm, reward, learning_rate, balance, **common)
        model.fit(data.of_kind(kind), n_steps=steps, n_steps_per_epoch=steps, **quiet)
        networks[kind] = exported(model)
    spent_s = time.process_time() - began_cpu
    policy = Policy(networks, scenario=data.scenario.name, made_with=shlex.join(["python", *sys.argv]))
    validation = data.scenario.replace(split="validation", reward="shared")
    found = evaluate(policy, validation, range(episodes)).means["J"]
    droop = evaluate(find_controller("droop-tuned", validation), validation, range(episodes)).means["J"]
    print(f"{algorithm}, {spent_s:.0f} s of CPU")
    print(f"mean J of {episodes} validation episodes: {found:.3f}, tuned droop {droop:.3f}")
    if save:
        policy.save(save, {"algorithm": algorithm, "seed": seed, "training_s": time.monotonic() - begun})
    return found, droop


if __name__ == "__main__":
    tyro.cli(main)
