"""PPO of libraries that leave the training loop to their user: TorchRL, skrl, and a single file in CleanRL's style."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import torch
from torch import nn

from docs.studies.library_batches import DISCOUNTS, EVALUATIONS, Batches, Setting, batches, example

costs = example("difference_reward").costs

HORIZON, EPOCHS, MINIBATCHES = 120, 3, 8
"""Steps between updates, passes over them, and minibatches of a pass."""
LEARNING_RATE, LOG_STD, GRADIENT_NORM = 3e-3, -1.0, 0.5
"""Initial learning rate, which falls to zero, initial logarithm of exploration, and largest norm of the gradient."""


class BestMean:
    """Keep the network of mean actions with the lowest mean J on validation.

    Parameters
    ----------
    network
        Network that is trained: observations (row, n_observation) to mean actions (row, n_action).
    of
        Environments of the training, the validation and the test.
    on
        What is trained.
    """

    def __init__(self, network: nn.Module, of: Batches, on: Setting):
        self.network, self.of, self.best = network, of, np.inf
        self.updates = max(1, on.steps // (on.num_envs * HORIZON))
        self._every = max(1, self.updates // EVALUATIONS)

    def predict(self, observations: np.ndarray, state: Any, **_: Any) -> tuple[np.ndarray, Any]:
        """Return the mean actions, in the form of Stable-Baselines3."""
        with torch.no_grad():
            return self.network(tensor(observations)).clamp(-1.0, 1.0).numpy(), state

    def evaluate(self, update: int) -> None:
        """Evaluate the network before an update, unless it is too soon."""
        if update % self._every and update < self.updates:
            return
        self.of.validation.obs_rms = self.of.train.obs_rms.copy()
        j = float(costs(self, self.of.validation).mean())
        if j < self.best:
            self.best, self._kept = j, (copy.deepcopy(self.network.state_dict()), self.of.validation.obs_rms)

    def tested(self) -> np.ndarray:
        """Evaluate once more, and return J of each test episode of the best network."""
        self.evaluate(self.updates)
        state, self.of.test.obs_rms = self._kept
        self.network.load_state_dict(state)
        return costs(self, self.of.test)


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


def cleanrl_ppo(on: Setting) -> np.ndarray:
    """Train the agent of docs/examples/cleanrl_ppo.py; advantages are those of a discount of 0."""
    check_no_discount("cleanrl-ppo", on)
    torch.manual_seed(on.seed)
    of = batches(on)
    envs, n_row = of.train, of.train.num_envs
    agent = example("cleanrl_ppo").Agent(*of.sizes)
    nn.init.constant_(agent.log_std, LOG_STD)
    optimizer = torch.optim.Adam(agent.parameters(), lr=LEARNING_RATE, eps=1e-5)
    best = BestMean(agent.actor, of, on)
    observation = tensor(envs.reset())
    for update in range(best.updates):
        best.evaluate(update)
        optimizer.param_groups[0]["lr"] = LEARNING_RATE * (1.0 - update / best.updates)
        course: list[tuple[torch.Tensor, ...]] = []
        with torch.no_grad():
            for _ in range(HORIZON):
                distribution = agent.distribution(observation)
                action = distribution.sample()
                after, reward, _, _ = envs.step(action.clamp(-1.0, 1.0).numpy())
                course.append((observation, action, distribution.log_prob(action).sum(-1), tensor(reward)))
                observation = tensor(after)
        parts = [torch.cat(each) for each in zip(*course, strict=True)]
        for _ in range(EPOCHS):
            for batch in torch.randperm(n_row * HORIZON).chunk(MINIBATCHES):
                observed, acted, old_log_prob, reward = (part[batch] for part in parts)
                value = agent.value(observed)
                advantage = (reward - value).detach()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                ratio = (agent.distribution(observed).log_prob(acted).sum(-1) - old_log_prob).exp()
                gain = torch.minimum(advantage * ratio, advantage * ratio.clamp(0.8, 1.2)).mean()
                optimizer.zero_grad()
                (0.5 * (value - reward).square().mean() - gain).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), GRADIENT_NORM)
                optimizer.step()
    return best.tested()


def torchrl_ppo(on: Setting) -> np.ndarray:
    """Train with the PPO loss and the advantages of TorchRL."""
    from tensordict import TensorDict  # pyright: ignore[reportMissingImports]
    from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule  # pyright: ignore[reportMissingImports]
    from torchrl.envs import ExplorationType, set_exploration_type  # pyright: ignore[reportMissingImports]
    from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator  # pyright: ignore[reportMissingImports]
    from torchrl.objectives import ClipPPOLoss  # pyright: ignore[reportMissingImports]
    from torchrl.objectives.value import GAE  # pyright: ignore[reportMissingImports]

    torch.manual_seed(on.seed)
    of = batches(on)
    envs, (n_observation, n_action) = of.train, of.sizes
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
    best = BestMean(mean, of, on)
    observation = tensor(envs.reset())
    for update in range(best.updates):
        best.evaluate(update)
        optimizer.param_groups[0]["lr"] = LEARNING_RATE * (1.0 - update / best.updates)
        course = []
        with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
            for _ in range(HORIZON):
                step = actor(TensorDict({"observation": observation}, [envs.num_envs]))
                after, reward, done, _ = envs.step(step["action"].clamp(-1.0, 1.0).numpy())
                observation, ends = tensor(after), torch.tensor(done)[:, None]
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


def skrl_ppo(on: Setting) -> np.ndarray:
    """Train the PPO agent of skrl."""
    from skrl.agents.torch.ppo import PPO, PPO_CFG  # pyright: ignore[reportMissingImports]
    from skrl.memories.torch import RandomMemory  # pyright: ignore[reportMissingImports]
    from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model  # pyright: ignore[reportMissingImports]

    torch.manual_seed(on.seed)
    of = batches(on)
    envs: Any = of.train
    spaces: dict[str, Any] = {"observation_space": envs.observation_space, "action_space": envs.action_space}
    network = [{"name": "net", "input": "OBSERVATIONS", "layers": [64, 64], "activations": "tanh"}]
    common = {**spaces, "device": "cpu", "network": network}
    policy: Any = gaussian_model(**common, output="ACTIONS", initial_log_std=LOG_STD)
    critic: Any = deterministic_model(**common, output="ONE")
    for model, role, last_gain in ((policy, "policy", 0.01), (critic, "value", 1.0)):
        model.init_state_dict(role=role)
        initialise(model, last_gain)
    best = BestMean(_SkrlMean(policy), of, on)
    settings = PPO_CFG(
        rollouts=HORIZON, learning_epochs=EPOCHS, mini_batches=MINIBATCHES, discount_factor=DISCOUNTS[on.reward],
        gae_lambda=0.0, learning_rate=LEARNING_RATE, learning_rate_scheduler=torch.optim.lr_scheduler.LinearLR,
        learning_rate_scheduler_kwargs={"start_factor": 1.0, "end_factor": 0.01, "total_iters": EPOCHS * best.updates},
        grad_norm_clip=GRADIENT_NORM, value_clip=0.0, value_loss_scale=0.5,
    )  # fmt: skip
    settings.experiment.write_interval = settings.experiment.checkpoint_interval = 0
    memory = RandomMemory(memory_size=HORIZON, num_envs=envs.num_envs, device="cpu")
    agent: Any = PPO(models={"policy": policy, "value": critic}, memory=memory, cfg=settings, device="cpu", **spaces)
    agent.init(trainer_cfg=None)
    agent.enable_training_mode(True)
    observation, steps = tensor(envs.reset()), best.updates * HORIZON
    for step in range(steps):
        if step % HORIZON == 0:
            best.evaluate(step // HORIZON)
        at: dict[str, int] = {"timestep": step, "timesteps": steps}
        with torch.no_grad():
            action, _ = agent.act(observation, None, **at)
            after, reward, done, infos = envs.step(action.clamp(-1.0, 1.0).numpy())
            following, ends = tensor(after), torch.tensor(done)[:, None]
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
