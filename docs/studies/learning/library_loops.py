"""PPO of libraries that leave the training loop to their user: TorchRL, skrl, and a single file in CleanRL's style."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import nn

from dcgrid_env.agents import training_env
from docs.studies.learning.library_batches import DISCOUNTS, BestOnValidation, Outcome, Setting, example

HORIZON, EPOCHS, MINIBATCHES = 120, 3, 8
"""Steps between updates, passes over them, and minibatches of a pass."""
LEARNING_RATE, LOG_STD, GRADIENT_NORM = 3e-3, -1.0, 0.5
"""Initial learning rate, which falls to zero, initial logarithm of exploration, and largest norm of the gradient."""


def train_rows(on: Setting, **fields: Any) -> Any:
    """Seed torch and return the rows of a training, with fields of ``training_env``."""
    torch.manual_seed(on.seed)
    return training_env(on.scenario, on.num_envs, reward=on.reward, **fields)


def n_updates(on: Setting) -> int:
    """Return the number of updates of a training, each after ``HORIZON`` steps."""
    return max(1, on.steps // (on.num_envs * HORIZON))


def best_mean(network: nn.Module, envs: Any, on: Setting) -> BestOnValidation:
    """Return the selection of a network from scaled observations to mean actions."""

    def act(rows: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return network(tensor(envs.scaling(rows))).numpy()

    return BestOnValidation(network, lambda: act, on)


def initialise(network: nn.Module, last_gain: float) -> None:
    """Set orthogonal weights, with ``last_gain`` in the last layer, and zero biases, as in CleanRL."""
    named = list(network.named_parameters())
    weights = [values for name, values in named if name.endswith("weight")]
    for weight in weights:
        nn.init.orthogonal_(weight, last_gain if weight is weights[-1] else 2**0.5)
    for name, values in named:
        if name.endswith("bias"):
            nn.init.zeros_(values)


def tensor(values: Any) -> torch.Tensor:
    """Return a copy in float32."""
    return torch.tensor(values, dtype=torch.float32)


def check_no_discount(library: str, on: Setting) -> None:
    """Raise ValueError for a reward with a discount above 0, which a library is not connected for."""
    if DISCOUNTS[on.reward]:
        raise ValueError(f"reward: {library} is written for a discount of 0, not for {on.reward!r}; use difference")


def cleanrl_ppo(on: Setting) -> Outcome:
    """Train the agent of docs/examples/cleanrl_ppo.py; advantages are those of a discount of 0."""
    check_no_discount("cleanrl-ppo", on)
    envs, script = train_rows(on), example("cleanrl_ppo")
    agent = script.Agent(envs)
    best = best_mean(agent.actor, envs, on)
    script.train(agent, envs, n_updates(on), on.seed, best.evaluate)
    return best.tested()


def torchrl_ppo(on: Setting) -> Outcome:
    """Train with the PPO loss and the advantages of TorchRL."""
    from tensordict import TensorDict  # pyright: ignore[reportMissingImports]
    from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule  # pyright: ignore[reportMissingImports]
    from torchrl.envs import ExplorationType, set_exploration_type  # pyright: ignore[reportMissingImports]
    from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator  # pyright: ignore[reportMissingImports]
    from torchrl.objectives import ClipPPOLoss  # pyright: ignore[reportMissingImports]
    from torchrl.objectives.value import GAE  # pyright: ignore[reportMissingImports]

    envs = train_rows(on)
    (n_observation,), (n_action,) = envs.single_observation_space.shape, envs.single_action_space.shape
    layers: dict[str, Any] = {"num_cells": [64, 64], "activation_class": nn.Tanh}
    mean: Any = MLP(n_observation, n_action, **layers)
    value: Any = MLP(n_observation, 1, **layers)
    initialise(mean, 0.01)
    initialise(value, 1.0)
    scale = AddStateIndependentNormalScale(n_action, scale_mapping="exp")
    nn.init.constant_(next(scale.parameters()), LOG_STD)
    module = TensorDictModule(nn.Sequential(mean, scale), ["observation"], ["loc", "scale"])
    keys: Any = ["loc", "scale"]
    actor = ProbabilisticActor(module, keys, distribution_class=IndependentNormal, return_log_prob=True)
    critic = ValueOperator(value)
    advantage = GAE(gamma=DISCOUNTS[on.reward], lmbda=0.0, value_network=critic)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.0, normalize_advantage=True)
    optimizer = torch.optim.Adam(loss.parameters(), LEARNING_RATE)
    best, updates = best_mean(mean, envs, on), n_updates(on)
    observation = tensor(envs.reset(seed=on.seed)[0])
    for update in range(updates):
        best.evaluate(update / updates)
        optimizer.param_groups[0]["lr"] = LEARNING_RATE * (1.0 - update / updates)
        course = []
        with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
            for _ in range(HORIZON):
                step = actor(TensorDict({"observation": observation}, [envs.num_envs]))
                after, reward, terminated, truncated, _ = envs.step(step["action"].numpy())
                observation, ends = tensor(after), torch.tensor(terminated | truncated)[:, None]
                results = {"observation": observation, "reward": tensor(reward)[:, None], "done": ends}
                step["next"] = TensorDict({**results, "terminated": ends}, [envs.num_envs])
                course.append(step)
            batch = advantage(torch.stack(course, 1)).reshape(-1)
        for _ in range(EPOCHS):
            for part in batch[torch.randperm(len(batch))].chunk(MINIBATCHES):
                terms = loss(part)
                optimizer.zero_grad()
                (terms["loss_objective"] + 0.5 * terms["loss_critic"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), GRADIENT_NORM)
                optimizer.step()
    return best.tested()


def skrl_ppo(on: Setting) -> Outcome:
    """Train the PPO agent of skrl."""
    from skrl.agents.torch.ppo import PPO, PPO_CFG  # pyright: ignore[reportMissingImports]
    from skrl.memories.torch import RandomMemory  # pyright: ignore[reportMissingImports]
    from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model  # pyright: ignore[reportMissingImports]

    envs = train_rows(on)
    spaces = {"observation_space": envs.single_observation_space, "action_space": envs.single_action_space}
    network = [{"name": "net", "input": "OBSERVATIONS", "layers": [64, 64], "activations": "tanh"}]
    common = {**spaces, "device": "cpu", "network": network}
    policy: Any = gaussian_model(**common, output="ACTIONS", initial_log_std=LOG_STD)
    critic: Any = deterministic_model(**common, output="ONE")
    for model, role, last_gain in ((policy, "policy", 0.01), (critic, "value", 1.0)):
        model.init_state_dict(role=role)
        initialise(model, last_gain)
    best, updates = best_mean(_SkrlMean(policy), envs, on), n_updates(on)
    settings = PPO_CFG(
        rollouts=HORIZON, learning_epochs=EPOCHS, mini_batches=MINIBATCHES, discount_factor=DISCOUNTS[on.reward],
        gae_lambda=0.0, learning_rate=LEARNING_RATE, learning_rate_scheduler=torch.optim.lr_scheduler.LinearLR,
        learning_rate_scheduler_kwargs={"start_factor": 1.0, "end_factor": 0.01, "total_iters": EPOCHS * updates},
        grad_norm_clip=GRADIENT_NORM, value_clip=0.0, value_loss_scale=0.5,
    )  # fmt: skip
    settings.experiment.write_interval = settings.experiment.checkpoint_interval = 0
    memory = RandomMemory(memory_size=HORIZON, num_envs=envs.num_envs, device="cpu")
    agent: Any = PPO(models={"policy": policy, "value": critic}, memory=memory, cfg=settings, device="cpu", **spaces)
    agent.init(trainer_cfg=None)
    agent.enable_training_mode(True)
    observation, steps = tensor(envs.reset(seed=on.seed)[0]), updates * HORIZON
    for step in range(steps):
        if step % HORIZON == 0:
            best.evaluate(step / steps)
        at: dict[str, int] = {"timestep": step, "timesteps": steps}
        with torch.no_grad():
            action, _ = agent.act(observation, None, **at)
            after, reward, terminated, truncated, infos = envs.step(action.numpy())
            following, ends = tensor(after), torch.tensor(terminated | truncated)[:, None]
            agent.record_transition(
                observations=observation, states=None, actions=action, rewards=tensor(reward)[:, None],
                next_observations=following, next_states=None, terminated=ends, truncated=torch.zeros_like(ends),
                infos=infos, **at,
            )  # fmt: skip
        agent.post_interaction(**at)
        observation = following
    return best.tested()


class _SkrlMean(nn.Module):
    """Mean actions of a Gaussian model of skrl."""

    def __init__(self, model: Any):
        super().__init__()
        self.model = model

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        return self.model.compute({"observations": observations}, role="policy")[0]
