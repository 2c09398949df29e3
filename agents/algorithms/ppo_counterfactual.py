"""Proximal policy optimisation with counterfactual advantages: each agent is paid for what its own action changed.

J. Schulman et al., "Proximal policy optimization algorithms", arXiv 1707.06347, without a critic.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.utils import set_random_seed

from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training import sb3, sb3_models
from dcgrid_env.agents.training.batched_envs import JointVecEnv
from dcgrid_env.agents.training.config import Training, trained_on
from dcgrid_env.agents.training.counterfactual import Counterfactual, require_one_step
from dcgrid_env.agents.training.run_folder import torch
from dcgrid_env.agents.training.torch_modules import Perceptron
from dcgrid_env.agents.training.validation import made_with


@dataclass(frozen=True)
class PpoCounterfactual(Training):
    """Train a policy with PPO on counterfactual advantages."""

    num_envs: int = 32
    steps: int = 400_000
    learning_rate: float = 3e-3
    epochs: int = 3
    minibatches: int = 8
    clip: float = 0.2
    q_std: float = 0.1
    clock_std: float = 0.15
    last_std: float = 0.3
    max_grad_norm: float = 0.5


class KindsPolicy(BasePolicy):
    """A network for each kind of agent, from joint observations to the outputs of all agents."""

    def __init__(self, *args: Any, interface: PolicyInterface, networks: torch.nn.ModuleDict, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.interface, self.networks = interface, networks
        self.optimizer = self.optimizer_class(networks.parameters(), **self.optimizer_kwargs)

    def outputs(self, joint: torch.Tensor) -> torch.Tensor:
        each = [self.networks[kind](own) for kind, own in self.interface.inputs(joint).items()]
        return torch.cat([out.reshape(*joint.shape[:-1], -1) for out in each], -1)

    def _predict(self, observation: Any, deterministic: bool = False) -> torch.Tensor:
        raise NotImplementedError


class CounterfactualPpo(BaseAlgorithm):
    def __init__(self, cfg, vec_env, networks, interface):
        super().__init__(KindsPolicy, vec_env, cfg.learning_rate, device=cfg.device, support_multi_env=True)
        self.cfg, self.vec_env = cfg, vec_env
        self.counterfactual = Counterfactual(vec_env.scenario)
        self.joint = PolicyInterface(vec_env.scenario, "joint", preview=cfg.preview, act=cfg.act, outputs="change")
        clock = torch.as_tensor(self.joint.is_clock)
        self.parts = [part for part in (clock, ~clock) if part.any()]
        self.std = torch.where(clock, cfg.clock_std, cfg.q_std)
        self.policy = KindsPolicy(self.observation_space, self.action_space, interface=interface, networks=networks)

    def _setup_model(self):
        pass

    def learn(self, total_timesteps, callback=None, log_interval=1, tb_log_name="run", reset_num_timesteps=True, progress_bar=False):
        self._setup_learn(total_timesteps, callback, reset_num_timesteps, tb_log_name, progress_bar)
        left = self.lr_schedule(1.0) / self.cfg.learning_rate
        std = self.std * (self.cfg.last_std + (1.0 - self.cfg.last_std) * left)
        self.train_on(*self.rollout(std), std)
        return self

    def rollout(self, std):
        env, T = self.vec_env, self.vec_env.scenario.horizon
        obs = self._last_obs
        kept = [[], [], [], []]
        paid = 0.0
        with torch.no_grad():
            for _ in range(T):
                before = env.batch.save()
                mean = self.policy.outputs(torch.as_tensor(obs))
                out = mean + std * torch.randn_like(mean)
                action, u = (self.joint.action(obs, {"joint": o.numpy()}) for o in (out, mean))
                new, reward, *_ = env.step(action)
                A = self.counterfactual.of_step(before, env.batch.transition.state, action.astype(float), u.astype(float))
                joint = np.zeros(action.shape, np.float32)
                joint[:, self.joint.is_clock], joint[:, self.joint.is_q] = A
                for k, x in zip(kept, (obs, out.numpy(), mean.numpy(), joint)):
                    k.append(x)
                obs = new
                paid += float(reward.mean())
                self.num_timesteps += env.num_envs
        self.logger.record("train/cost", -paid / T)
        self._last_obs = None
        return [torch.as_tensor(np.concatenate(k)) for k in kept]

    def train_on(self, obs, out, mean, adv, std):
        cfg = self.cfg
        for part in self.parts:
            self.logger.record(f"train/adv{int(part[0])}", float(adv[:, part].std()))
            adv[:, part] /= adv[:, part].std() + 1e-8
        before = -0.5 * ((out - mean) / std) ** 2
        for g in self.policy.optimizer.param_groups:
            g["lr"] = self.lr_schedule(1.0)
        clipped = 0.0
        for _ in range(cfg.epochs):
            for rows in torch.randperm(len(obs)).chunk(cfg.minibatches):
                now = -0.5 * ((out[rows] - self.policy.outputs(obs[rows])) / std) ** 2
                ratio = torch.exp(now - before[rows])
                a = adv[rows]
                gain = torch.min(ratio * a, ratio.clamp(1 - cfg.clip, 1 + cfg.clip) * a)
                loss = -sum(gain[:, part].mean() for part in self.parts)
                self.policy.optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.policy.parameters(), cfg.max_grad_norm)
                self.policy.optimizer.step()
                clipped = float(((ratio - 1).abs() > cfg.clip).float().mean())
        self.logger.record("train/clipped", clipped)
        self._n_updates += cfg.epochs


def make(cfg, vec_env):
    set_random_seed(cfg.seed)
    s = vec_env.scenario
    interface = PolicyInterface(s, "shared", preview=cfg.preview, nameplate=True, array=lambda a: torch.from_numpy(np.array(a)))
    rng = np.random.default_rng(cfg.seed)
    shape = (vec_env.num_envs, vec_env.action_space.shape[0])
    constant, observed = rng.uniform(-1.0, 1.0, shape), []
    vec_env.seed(sb3.episode_seed(cfg.seed, 0, vec_env.n_envs))
    observation = vec_env.reset()
    for _ in range(s.horizon):
        drawn = 0.3 * rng.standard_normal(shape)
        observed.append(observation)
        action = np.where(vec_env.clocks, 1.0 - np.abs(drawn), constant + drawn)
        observation, *_ = vec_env.step(np.clip(action, -1.0, 1.0).astype(np.float32))
    rows = torch.as_tensor(np.concatenate(observed))
    nets = {}
    for kind, own in interface.inputs(rows).items():
        own = own.reshape(-1, own.shape[-1])
        nets[kind] = Perceptron(own.mean(0), own.std(0).clamp(min=1e-2), interface.widths[kind][1], cfg.hidden)
    model = CounterfactualPpo(cfg, vec_env, torch.nn.ModuleDict(nets), interface)
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def main(cfg: PpoCounterfactual) -> Path:
    from dcgrid_env.agents.training.run_folder import open_run
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec
    from dcgrid_env import under_own_control
    torch.set_num_threads(cfg.threads)
    spec = ScenarioSpec(cfg.scenario, cfg.set)
    scenario = under_own_control(spec.make("train", observe=cfg.observe))
    vec_env = JointVecEnv(scenario, cfg.num_envs, "both", "setpoint")
    with open_run(cfg.out, cfg, cfg.resume, [spec.make("validation")]) as run:
        model = make(cfg, vec_env)
        def exported():
            return Policy({k: n.exported() for k, n in model.policy.networks.items()}, observe=cfg.observe, preview=cfg.preview, act=cfg.act, nameplate=True, outputs="change", scenario=trained_on(cfg), made_with=made_with())
        return sb3.train(cfg, run, vec_env, model, iterations=max(1, round(cfg.steps / (vec_env.num_envs * scenario.horizon))), exported=exported, learning_rate=lambda done: cfg.learning_rate * (1 - done))
