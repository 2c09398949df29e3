"""Train a policy with proximal policy optimisation (PPO) and counterfactual advantages.

Training uses the grid model and all node voltages. The advantage of an agent's clock or reactive power is a difference
in team cost: between the agent's action and the policy's mean action, with the actions of all others unchanged
(``training.counterfactual``). Critic and discount are not used. Each kind of agent has one network. It uses the
agent's observations only, and its outputs are changes from the action that keeps the current state
(``policy.interface``).

    loss = - sum over c of mean(min(ratio_c A_c, clip(ratio_c, 1 - clip, 1 + clip) A_c))      c: clock, reactive power

Each A_c is divided by its standard deviation in the rollout, and each component has a separate likelihood ratio. A
rollout is a complete episode in every environment.

The algorithm scores higher than ``ppo`` where both were compared (docs/training.md). It rejects devices and costs that
affect later steps; use ``ppo`` for them, or without a grid model.

The implementation uses the vector environment and the base classes of Stable-Baselines3, but not its PPO. That PPO has
one advantage and one likelihood for each action, a critic, and one network for all rows.

Reference: J. Schulman et al., "Proximal policy optimization algorithms", arXiv 1707.06347.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed

from dcgrid_env import under_own_control
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training import sb3, sb3_models
from dcgrid_env.agents.training.agent_networks import AgentNetworks
from dcgrid_env.agents.training.batched_envs import RowVecEnv
from dcgrid_env.agents.training.config import Training, check, trained_on
from dcgrid_env.agents.training.counterfactual import Counterfactual, require_one_step
from dcgrid_env.agents.training.row_views import make_rows
from dcgrid_env.agents.training.run_folder import device_of, torch
from dcgrid_env.agents.training.torch_modules import Perceptron, forgiving_clip
from dcgrid_env.agents.training.validation import made_with
from dcgrid_env.baselines import make_controller
from dcgrid_env.baselines.scenario_spec import ScenarioSpec

SMALLEST_STD = 1e-2
"""Smallest standard deviation for the normalisation of observations."""
NO_ADVANTAGE = 1e-9
"""Smallest standard deviation for the normalisation of advantages.

Advantages are all equal for an action without effect, such as a clock that is fixed at its maximum.
"""


@dataclass(frozen=True)
class PpoCounterfactual(Training):
    """Train a policy with PPO on counterfactual advantages."""

    view: Literal["shared", "centralised"] = "shared"
    """Only shared is allowed: one policy, applied to each agent's observations. Advantages are computed per agent."""
    num_envs: int = 32
    """Number of environments that are simulated in parallel, each with a separate episode."""
    steps: int = 300_000
    """Total number of environment steps."""
    learning_rate: float = 3e-3
    """Initial learning rate; it decays linearly to zero."""
    epochs: int = 3
    """Number of passes over each rollout."""
    minibatches: int = 8
    """Number of minibatches in each pass."""
    clip: float = 0.2
    """Clip range of the likelihood ratio."""
    q_std: float = 0.1
    """Initial standard deviation of reactive power in exploration, as a fraction of the agent's limit."""
    clock_std: float = 0.15
    """Initial standard deviation of the clock in exploration, in units of its action, which ranges from -1 to 1."""
    last_std: float = 0.3
    """Final value of both standard deviations as a fraction of the initial value; they decrease linearly."""
    within_reach: bool = False
    """Limit the mean reactive power to the converter's capability at the previous step. Without this option, all
    actions sampled around a mean far beyond the limit have the same effect. No effect with --act clock."""
    max_grad_norm: float = 0.5
    """Maximum norm of the gradient; larger gradients are scaled down."""


class Rollout(NamedTuple):
    """Data of a batch of episodes; rows are steps and environments, columns are entries of the joint action."""

    observations: torch.Tensor
    """Joint observations, (row, n_observation)."""
    outputs: torch.Tensor
    """Sampled outputs, (row, n_action)."""
    means: torch.Tensor
    """Means of the outputs, (row, n_action)."""
    advantages: torch.Tensor
    """(row, n_action)"""
    lowest: torch.Tensor
    highest: torch.Tensor
    """Lower (``lowest``) and upper limit of the means, (row, n_action)."""
    costs: np.ndarray
    """Cost of each step, (step, env)."""


class CounterfactualPpo(BaseAlgorithm):
    """PPO on the advantages of ``Counterfactual``.

    Parameters
    ----------
    cfg
        The configuration.
    vec_env
        Environments of joint observations and actions.
    policy
        The networks.
    """

    def __init__(self, cfg: PpoCounterfactual, vec_env: RowVecEnv, policy: AgentNetworks):
        super().__init__(AgentNetworks, vec_env, cfg.learning_rate, device=cfg.device, support_multi_env=True)
        self.cfg, self.vec_env = cfg, vec_env
        self.policy = self.actor = policy.to(self.device)
        self.counterfactual = Counterfactual(vec_env.scenario)
        clock = torch.as_tensor(policy.acting.is_clock, device=self.device)
        self.components = {"clock": clock, "q": ~clock}
        """Which entries of the joint action are of a component."""
        self.first_std = torch.where(clock, cfg.clock_std, cfg.q_std)
        self._setup_model()

    def _setup_model(self) -> None:
        """A constant learning rate, until the training sets another."""
        self._setup_lr_schedule()

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        """What a checkpoint holds."""
        return ["policy", "policy.optimizer"], []

    @property
    def std(self) -> torch.Tensor:
        """Standard deviation of the exploration now, (n_action,); it falls as the learning rate does."""
        left = self.lr_schedule(1.0) / self.cfg.learning_rate  # SB3's schedules take what is left of the training
        return self.first_std * (self.cfg.last_std + (1.0 - self.cfg.last_std) * left)

    def learn(
        self,
        total_timesteps: int,
        callback: Any = None,
        log_interval: int | None = None,
        tb_log_name: str = "run",
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> CounterfactualPpo:
        """Learn from an episode of every environment, again and again until that many steps are done."""
        total, _ = self._setup_learn(total_timesteps, callback, reset_num_timesteps, tb_log_name, progress_bar)
        while self.num_timesteps < total:
            self.update(self.rollout(self.vec_env.scenario.horizon))
        return self

    def rollout(self, steps: int) -> Rollout:
        """Drive every environment by the policy and its exploration for so many steps."""
        env, policy, std = self.vec_env, self.actor, self.std
        joint: Any = self._last_obs
        kept, costs = ([], [], [], [], [], []), []
        with torch.no_grad():
            for _ in range(steps):
                before = env.batch.save()
                limits = self.limits(before.state)
                mean = forgiving_clip(policy.outputs(self._tensor(joint)), *limits)
                outputs = mean + std * torch.randn_like(mean)
                action, asked = (policy.action(joint, each).astype(np.float64) for each in (outputs, mean))
                following, reward, *_ = env.step(action)
                advantage = self._tensor(self.counterfactual.of_step(before, env.batch.transition.state, action, asked))
                for rows, each in zip(kept, (self._tensor(joint), outputs, mean, advantage, *limits), strict=True):
                    rows.append(each)
                costs.append(-reward)
                joint, self.num_timesteps = following, self.num_timesteps + env.num_envs
        self._last_obs = joint
        observations, outputs, means, advantages, lowest, highest = map(torch.cat, kept)
        return Rollout(observations, outputs, means, advantages, lowest, highest, np.array(costs))

    def limits(self, state: Any) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the lower and upper limit of the means after a state, (env, n_action).

        The limits of a change in q correspond to the converter's limits.
        """
        shape = len(state.q_kvar), len(self.first_std)
        lowest, highest = (torch.full(shape, sign * torch.inf, device=self.device) for sign in (-1.0, 1.0))
        if self.cfg.within_reach:
            scale, entries = np.maximum(self.vec_env.scenario.q_scale_kvar, 1e-9), self.components["q"]
            lowest[:, entries] = self._tensor((-state.q_limit_kvar - state.q_kvar) / scale)
            highest[:, entries] = self._tensor((state.q_limit_kvar - state.q_kvar) / scale)
        return lowest, highest

    def normalised(self, advantages: torch.Tensor) -> torch.Tensor:
        """Divide the advantages of each component by their standard deviation, (row, n_action)."""
        scales = torch.ones_like(advantages[0])
        for entries in self.components.values():
            if entries.any():
                scales[entries] = advantages[:, entries].std().clamp(min=NO_ADVANTAGE)
        return advantages / scales

    def loss(self, data: Rollout, advantages: torch.Tensor, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the loss of some rows and the fraction of likelihood ratios outside the clip range."""
        clip, chosen = self.cfg.clip, data.outputs[rows]
        now = forgiving_clip(self.actor.outputs(data.observations[rows]), data.lowest[rows], data.highest[rows])
        ratio = torch.exp(0.5 * (((chosen - data.means[rows]) / self.std) ** 2 - ((chosen - now) / self.std) ** 2))
        gain = torch.min(ratio * advantages[rows], ratio.clamp(1.0 - clip, 1.0 + clip) * advantages[rows])
        of_components = [gain[:, entries].mean() for entries in self.components.values() if entries.any()]
        beyond = ((ratio - 1.0).abs() > clip).float().mean()
        return -torch.stack(of_components).sum(), beyond

    def update(self, data: Rollout) -> None:
        """Take an optimiser step for each minibatch, in several passes over a rollout."""
        optimizer, advantages, beyond = self.actor.optimizer, self.normalised(data.advantages), []
        self._update_learning_rate(optimizer)
        for _ in range(self.cfg.epochs):
            for rows in torch.randperm(len(advantages), device=self.device).chunk(self.cfg.minibatches):
                loss, clipped = self.loss(data, advantages, rows)
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.actor.parameters(), self.cfg.max_grad_norm)
                optimizer.step()
                beyond.append(clipped)
        self._n_updates += self.cfg.epochs
        self.logger.record("train/cost", float(data.costs.mean()))
        self.logger.record("train/clip_fraction", float(torch.stack(beyond).mean()))

    def _tensor(self, values: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(values, dtype=torch.float32, device=self.device)


def vec_env_for(cfg: PpoCounterfactual) -> RowVecEnv:
    """Return the vector environment of the training split; raise ValueError if a setting or the scenario is invalid."""
    check(cfg)
    if cfg.view != "shared":
        raise ValueError(f"view is {cfg.view!r}; an advantage is a single agent's: give shared, or train ppo")
    device_of(cfg.device)
    torch.set_num_threads(cfg.threads)
    spec = ScenarioSpec(cfg.scenario, cfg.set)
    scenario = under_own_control(spec.make("train", observe=cfg.observe))
    require_one_step(cfg.algorithm(), scenario)
    rows = cfg.num_envs * scenario.horizon
    if cfg.minibatches > rows // 2:
        raise ValueError(f"minibatches is {cfg.minibatches}; a rollout here has {rows} rows: give at most half as many")
    make_controller("droop-tuned", spec.make("validation"))  # ValueError where it has no gains, before all the work
    return RowVecEnv(make_rows(scenario, act=cfg.act), cfg.num_envs)


def make(cfg: PpoCounterfactual, vec_env: RowVecEnv) -> CounterfactualPpo:
    """Return the initialised algorithm."""
    set_random_seed(cfg.seed)
    chosen: dict[str, Any] = {"preview": cfg.preview, "act": cfg.act, "nameplate": True, "outputs": "change"}
    device = device_of(cfg.device)
    seen = PolicyInterface(
        vec_env.scenario, "shared", **chosen, array=lambda values: torch.from_numpy(np.array(values)).to(device)
    )
    acting = PolicyInterface(vec_env.scenario, "joint", **chosen)
    observed, _ = sb3_models.random_episode(vec_env, cfg.seed)
    networks = {}
    for kind, inputs in seen.inputs(torch.as_tensor(observed, device=device)).items():
        mean, std = inputs.mean((0, 1)), inputs.std((0, 1)).clamp(min=SMALLEST_STD)
        networks[kind] = Perceptron(mean, std, seen.widths[kind][1], cfg.hidden)
    policy = AgentNetworks(
        vec_env.observation_space, vec_env.action_space,
        networks=torch.nn.ModuleDict(networks), seen=seen, acting=acting,
    )  # fmt: skip
    model = CounterfactualPpo(cfg, vec_env, policy)
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def exported(cfg: PpoCounterfactual, model: CounterfactualPpo) -> Policy:
    """Return the mean of the current policy as NumPy arrays."""
    networks: dict[str, Any] = {kind: net.exported() for kind, net in model.actor.networks.items()}  # pyright: ignore
    return Policy(
        networks, observe=cfg.observe, preview=cfg.preview, act=cfg.act, nameplate=True, outputs="change",
        scenario=trained_on(cfg), made_with=made_with(),
    )  # fmt: skip


def main(cfg: PpoCounterfactual) -> Path:
    """Train a policy and return the output folder."""
    vec_env = vec_env_for(cfg)
    with sb3.run_of(cfg) as run:
        model = make(cfg, vec_env)
        return sb3.train(
            cfg, run, vec_env, model,
            iterations=max(1, round(cfg.steps / (vec_env.num_envs * vec_env.scenario.horizon))),
            exported=lambda: exported(cfg, model),
            learning_rate=lambda done: cfg.learning_rate * (1.0 - done),
        )  # fmt: skip
