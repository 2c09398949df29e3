"""TorchRL on the PettingZoo environment: PPO with one policy for all data centres and one for all inverters.

``PettingZooWrapper`` takes ``dcgrid_env.parallel_env`` without infos and stacks the agents of a group: ``dc_0``.. act
on (clock, q), ``inv_0``.. on (q,), so each kind is a group.

    python docs/examples/torchrl_pettingzoo.py --updates 3
"""

from pathlib import Path

import torch
import tyro
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.envs import PettingZooWrapper
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import dcgrid_env
from dcgrid_env.agents import Network, Policy
from dcgrid_env.baselines import make_controller, rollout

SCENARIO = "ieee33-weak"
KINDS = {"datacenter": "dc_", "inverter": "inv_"}


def learner(env: PettingZooWrapper, group: str, learning_rate: float) -> tuple:
    """Actor, mean network, advantage, loss and optimiser of a group; its agents share them."""
    observation, action = env.observation_spec[group, "observation"], env.action_spec[group, "action"]
    sizes = {"in_features": observation.shape[-1], "num_cells": [64, 64], "activation_class": nn.Tanh}
    n_action = action.shape[-1]
    mean = MLP(out_features=n_action, **sizes)
    nn.init.normal_(mean[-1].weight, std=0.01)
    scaled = nn.Sequential(mean, AddStateIndependentNormalScale(n_action, scale_lb=0.05))
    actor = ProbabilisticActor(
        TensorDictModule(scaled, [(group, "observation")], [(group, "loc"), (group, "scale")]),
        in_keys=[(group, "loc"), (group, "scale")],
        out_keys=[(group, "action")],
        distribution_class=TanhNormal,
        return_log_prob=True,
        log_prob_key=(group, "log_prob"),
    )
    critic = TensorDictModule(MLP(out_features=1, **sizes), [(group, "observation")], [(group, "state_value")])
    keys = {"value": (group, "state_value"), "advantage": (group, "advantage"), "value_target": (group, "target")}
    advantage = GAE(gamma=0.5, lmbda=0.95, value_network=critic, average_gae=True)
    ends = {name: (group, name) for name in ("reward", "done", "terminated")}
    advantage.set_keys(**keys, **ends)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.0, normalize_advantage=False)
    loss.set_keys(action=(group, "action"), sample_log_prob=(group, "log_prob"), **keys, **ends)
    return actor, mean, advantage, loss, torch.optim.Adam(loss.parameters(), learning_rate)


def exported(means: dict[str, MLP]) -> Policy:
    """The mean actions as a policy of NumPy arrays, which dcgrid drives, saves and benchmarks without torch."""
    networks = {}
    for kind, mean in means.items():
        linear = [layer for layer in mean if isinstance(layer, nn.Linear)]
        arrays = [(layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy().copy()) for layer in linear]
        networks[kind] = Network(arrays, activation="tanh", squash="tanh")
    return Policy(networks, scenario=SCENARIO)


def main(
    updates: int = 3,
    rollout_steps: int = 600,
    learning_rate: float = 1e-3,
    episodes: int = 20,
    seed: int = 0,
    reward: str = "local",
    save: Path | None = None,
    checkpoint: Path | None = None,
) -> tuple[float, float]:
    """Train, and give the mean J of validation episodes before and after."""
    torch.manual_seed(seed)
    parallel = dcgrid_env.parallel_env(SCENARIO, reward=reward, info="none")
    groups = {kind: [a for a in parallel.possible_agents if a.startswith(prefix)] for kind, prefix in KINDS.items()}
    env = PettingZooWrapper(parallel, group_map=groups, seed=seed)
    learners = {kind: learner(env, kind, learning_rate) for kind in groups}
    together = TensorDictSequential(*(actor for actor, *_ in learners.values()))
    means = {kind: mean for kind, (_, mean, *_) in learners.items()}
    validation = dcgrid_env.make_scenario(SCENARIO, split="validation")
    before = float(rollout(validation, exported(means), range(episodes)).costs().mean())
    for _ in range(updates):
        with torch.no_grad():
            batch = env.rollout(rollout_steps, together, break_when_any_done=False)  # episodes one after the other
        for _, _, advantage, loss, optimizer in learners.values():
            with torch.no_grad():
                advantage(batch)
            for _ in range(10):
                for part in batch[torch.randperm(rollout_steps)].split(rollout_steps // 4):
                    optimizer.zero_grad()
                    terms = loss(part)
                    (terms["loss_objective"] + terms["loss_critic"]).backward()
                    nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                    optimizer.step()
    policy = exported(means)
    after = float(rollout(validation, policy, range(episodes)).costs().mean())
    droop = rollout(validation, make_controller("droop-tuned", validation), range(episodes)).costs().mean()
    print(f"mean J of {episodes} validation episodes: {before:.3f} before, {after:.3f} after, tuned droop {droop:.3f}")
    if save:
        policy.save(save)
    if checkpoint:
        checkpoint.parent.mkdir(parents=True, exist_ok=True)
        torch.save({kind: mean.state_dict() for kind, mean in means.items()}, checkpoint)
    return before, after


if __name__ == "__main__":
    tyro.cli(main)
