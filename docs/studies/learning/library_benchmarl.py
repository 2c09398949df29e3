"""Algorithms of BenchMARL: the channels of an environment are the agents of one group, with shared parameters."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from benchmarl.algorithms import IppoConfig, MaddpgConfig, MappoConfig  # pyright: ignore[reportMissingImports]
from benchmarl.environments.common import TaskClass  # pyright: ignore[reportMissingImports]
from benchmarl.experiment import Callback, Experiment, ExperimentConfig  # pyright: ignore[reportMissingImports]
from benchmarl.models.mlp import MlpConfig  # pyright: ignore[reportMissingImports]
from tensordict import TensorDict  # pyright: ignore[reportMissingImports]
from torch import nn
from torchrl.data import Bounded, Categorical, Composite, Unbounded  # pyright: ignore[reportMissingImports]
from torchrl.envs import EnvBase, ExplorationType, set_exploration_type  # pyright: ignore[reportMissingImports]

from dcgrid_env.agents import ppo_settings, sac_settings, sb3_vec_env
from docs.studies.learning.library_batches import OFF_POLICY_BATCH, Outcome, Setting
from docs.studies.learning.library_loops import GRADIENT_NORM, best_mean, initialise, tensor, train_rows

GROUP = "channels"
ALGORITHMS = {"ippo": IppoConfig, "mappo": MappoConfig, "maddpg": MaddpgConfig}
STEPS_BETWEEN, NOISE = 4, 0.2
"""Steps of the batch and of the optimisers in an iteration of BenchMARL's loop, off policy."""


class Channels(EnvBase):
    """A batch as an environment of TorchRL: (environment, channel) in place of rows."""

    def __init__(self, envs: Any):
        self.n_channel, n = envs.rows.per_env, envs.n_envs
        super().__init__(device="cpu", batch_size=torch.Size([n]))
        self.envs, shape = envs, torch.Size([n, self.n_channel])
        (n_observation,), (n_action,) = envs.single_observation_space.shape, envs.single_action_space.shape

        def grouped(**entries: Any) -> Composite:
            return Composite({GROUP: Composite(entries, shape=shape)}, shape=self.batch_size)

        self.observation_spec = grouped(observation=Unbounded(torch.Size([*shape, n_observation])))
        self.action_spec = grouped(action=Bounded(-1.0, 1.0, torch.Size([*shape, n_action])))
        self.reward_spec = grouped(reward=Unbounded(torch.Size([*shape, 1])))
        self.done_spec = Composite(
            {"done": Categorical(2, torch.Size([n, 1]), dtype=torch.bool)}, shape=self.batch_size
        )
        self.now: Any = None

    def _set_seed(self, seed: int | None) -> None:
        """Do nothing: the batch is seeded."""

    def _reset(self, tensordict: Any = None, **_: Any) -> TensorDict:
        """Return the first observations; the batch begins the next episodes by itself."""
        self.now = self.envs.reset()[0] if self.now is None else self.now
        return self._grouped(observation=self.now)

    def _step(self, tensordict: Any) -> TensorDict:
        action = tensordict[GROUP, "action"].flatten(0, 1).numpy()
        self.now, reward, terminated, truncated, _ = self.envs.step(action)
        after = self._grouped(observation=self.now, reward=reward)
        ends = torch.tensor(terminated | truncated).reshape(*self.batch_size, -1)[:, :1]
        return after.update({"done": ends, "terminated": ends})

    def _grouped(self, **rows: Any) -> TensorDict:
        shape = (*self.batch_size, self.n_channel)
        of_group = TensorDict({key: tensor(values).reshape(*shape, -1) for key, values in rows.items()}, shape)
        return TensorDict({GROUP: of_group}, self.batch_size)


class ChannelsTask(TaskClass):
    """The batch as a task of BenchMARL."""

    def __init__(self, name: str, envs: Any):
        super().__init__(name, {})
        self.envs, self.n_channel = envs, envs.rows.per_env

    def get_env_fun(self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any) -> Callable:
        """Return a function that makes the environment."""
        return lambda: Channels(self.envs)

    def supports_continuous_actions(self) -> bool:
        """Return that actions are continuous."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Return that no action is discrete."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """Return the steps of an episode."""
        return self.envs.rows.n_decisions

    def has_render(self, env: EnvBase) -> bool:
        """Return that nothing is drawn."""
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Return the names of the channels."""
        return {GROUP: [f"channel_{i}" for i in range(self.n_channel)]}

    def observation_spec(self, env: EnvBase) -> Composite:
        """Return the observations."""
        return env.full_observation_spec_unbatched

    def action_spec(self, env: EnvBase) -> Composite:
        """Return the actions."""
        return env.full_action_spec_unbatched

    def info_spec(self, env: EnvBase) -> None:
        """Return None: info is empty."""

    def state_spec(self, env: EnvBase) -> None:
        """Return None: a centralised critic takes all observations."""

    def action_mask_spec(self, env: EnvBase) -> None:
        """Return None: each action is always possible."""

    @staticmethod
    def env_name() -> str:
        """Return the name in BenchMARL's folders."""
        return "dcgrid"


class _Mean(nn.Module):
    """Mean actions of a group's policy for rows, (row, n_observation) to (row, n_action)."""

    def __init__(self, policy: nn.Module, n_channel: int):
        super().__init__()
        self.policy, self.n_channel = policy, n_channel

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        shape = (len(observations) // self.n_channel, self.n_channel)
        seen = TensorDict({(GROUP, "observation"): observations.reshape(*shape, -1)}, shape[:1])
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            return self.policy(seen)[GROUP, "action"].flatten(0, 1)


class _Updates(Callback):
    """Validation before each update, and the falling learning rate."""

    def __init__(self, updates: int, rate: float):
        super().__init__()
        self.updates, self.rate = updates, rate
        self.best: Any = None

    def on_batch_collected(self, batch: Any) -> None:
        share = self.experiment.n_iters_performed / self.updates
        self.best.evaluate(share)
        for optimizer in self.experiment.optimizers[GROUP].values():
            optimizer.param_groups[0]["lr"] = self.rate * (1.0 - share)


def benchmarl(algorithm: str, on: Setting) -> Outcome:
    """Train an algorithm of BenchMARL with the settings of Stable-Baselines3's."""
    envs = train_rows(on)
    config, algorithm_config = ExperimentConfig.get_from_yaml(), ALGORITHMS[algorithm].get_from_yaml()
    if algorithm_config.has_centralized_critic():
        algorithm_config.share_param_critic = on.reward == "shared"  # else each agent has its own value
    is_on_policy = algorithm_config.on_policy()
    frames = on_policy(config, algorithm_config, on) if is_on_policy else off_policy(config, on)
    n_updates = max(1, on.steps // frames)
    config.max_n_frames = frames * n_updates
    config.loggers, config.evaluation, config.create_json = [], False, False
    network = MlpConfig(num_cells=[64, 64], layer_class=nn.Linear, activation_class=nn.Tanh)
    updates = _Updates(n_updates, config.lr)
    with tempfile.TemporaryDirectory() as config.save_folder:
        experiment = Experiment(
            task=ChannelsTask(on.scenario, envs), algorithm_config=algorithm_config, model_config=network,
            critic_model_config=network, seed=on.seed, config=config, callbacks=[updates],
        )  # fmt: skip
        policy = experiment.group_policies[GROUP]
        initialise(policy, 0.01)
        updates.best = best_mean(_Mean(policy, envs.rows.per_env), envs, on)
        experiment.run()
    return updates.best.tested()


def on_policy(config: Any, algorithm: Any, on: Setting) -> int:
    """Set up IPPO or MAPPO by ``ppo_settings``, and return the frames of a rollout."""
    made = sb3_vec_env(on.scenario, on.num_envs, reward=on.reward)
    settings = ppo_settings(made)
    frames = on.num_envs * settings["n_steps"]
    config.gamma, config.lr, config.clip_grad_val = settings["gamma"], settings["learning_rate"](1.0), GRADIENT_NORM
    config.on_policy_collected_frames_per_batch, config.on_policy_n_envs_per_worker = frames, on.num_envs
    config.on_policy_minibatch_size = max(2, settings["batch_size"] // made.rows_per_env)
    config.on_policy_n_minibatch_iters = settings["n_epochs"]
    algorithm.lmbda, algorithm.critic_coef = settings["gae_lambda"], 0.5
    deviation = np.exp(settings["policy_kwargs"]["log_std_init"])
    algorithm.scale_mapping, algorithm.use_tanh_normal = f"biased_softplus_{deviation:.3f}", False
    return frames


def off_policy(config: Any, on: Setting) -> int:
    """Set up MADDPG by ``sac_settings``, and return the frames of an iteration."""
    made = sb3_vec_env(on.scenario, on.num_envs, reward=on.reward)
    settings = sac_settings(made)
    config.gamma, config.lr, config.clip_grad_val = settings["gamma"], settings["learning_rate"](1.0), None
    frames = on.num_envs * STEPS_BETWEEN
    config.off_policy_collected_frames_per_batch, config.off_policy_n_envs_per_worker = frames, on.num_envs
    config.off_policy_n_optimizer_steps = STEPS_BETWEEN
    config.off_policy_train_batch_size = max(2, OFF_POLICY_BATCH // made.rows_per_env)
    config.off_policy_memory_size = settings["buffer_size"] // made.rows_per_env
    config.exploration_eps_init = config.exploration_eps_end = NOISE
    return frames
