"""Train a policy with PPO, SAC or TD3 of Stable-Baselines3, unchanged.

Environments, rows and rewards are those of ``sb3_vec_env``. The settings are those of ``ppo_settings``,
``sac_settings`` and ``td3_settings``, the same for every scenario. By default a row is a channel of an agent, and
training is paid by difference rewards, which use the grid model. With ``--reward shared`` all rows receive the team
reward, and training needs no model. The policy uses the agents' observations only. Regulators and capacitor banks keep
their own control, unless agents choose its set points.

A training consists of stages. At the end of each one the policy is evaluated on the validation split, and the best is
kept.

References: J. Schulman et al., "Proximal policy optimization algorithms", arXiv 1707.06347; T. Haarnoja et al., "Soft
actor-critic algorithms and applications", arXiv 1812.05905; S. Fujimoto et al., "Addressing function approximation
error in actor-critic methods", arXiv 1802.09477.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed

from dcgrid_env import under_own_control
from dcgrid_env.agents.from_sb3.sb3_policy import to_policy
from dcgrid_env.agents.training.batched_envs import RowVecEnv
from dcgrid_env.agents.training.config import Training, check, trained_on
from dcgrid_env.agents.training.row_form import Outputs, View
from dcgrid_env.agents.training.run_folder import Run, device_of, open_run, torch
from dcgrid_env.agents.training.sb3_settings import ppo_settings, sac_settings, td3_settings
from dcgrid_env.agents.training.training_loop import finish, progress
from dcgrid_env.agents.training.validation import Validation
from dcgrid_env.agents.training.vec_env import sb3_vec_env
from dcgrid_env.baselines import make_controller
from dcgrid_env.baselines.scenario_spec import ScenarioSpec

REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
"""Arrays of a replay buffer."""


@dataclass(frozen=True)
class StableBaselines3(Training):
    """Settings of a training with Stable-Baselines3."""

    view: View | None = None
    """Row of the policy: a channel of an agent, an agent (shared), or all agents (joint). Default: that of
    sb3_vec_env."""
    outputs: Outputs | None = None
    """Actions: set points, changes from the action that keeps the current state, or corrections of the tuned droop.
    Default: that of sb3_vec_env."""
    reward: Literal["difference", "local", "shared"] | None = None
    """Reward of a row: the cost that its action saves, the cost of its agent, or the team's. Default: that of
    sb3_vec_env."""
    num_envs: int = 32
    """Number of environments that are simulated in parallel, each with a separate episode."""
    steps: int = 60_000
    """Total number of steps of all environments together."""
    validate_every: int = 5_000
    """Steps of a stage, after which the policy is evaluated on validation and a checkpoint is written."""

    model: ClassVar[Any]
    """Algorithm of Stable-Baselines3."""
    settings: ClassVar[Callable[..., dict[str, Any]]]
    """Function that returns its settings for environments and their steps."""

    @property
    def kind(self) -> str:
        """Second part of the folder name: the algorithm, and the form of its rows as far as it is given."""
        return "-".join(name for name in (self.algorithm(), self.view, self.outputs, self.reward) if name)


@dataclass(frozen=True)
class Ppo(StableBaselines3):
    """Train a policy with PPO."""

    model = PPO
    settings = staticmethod(ppo_settings)


@dataclass(frozen=True)
class Sac(StableBaselines3):
    """Train a policy with SAC."""

    num_envs: int = 16
    """Number of environments that are simulated in parallel, each with a separate episode."""

    model = SAC
    settings = staticmethod(lambda envs, _: sac_settings(envs))


@dataclass(frozen=True)
class Td3(StableBaselines3):
    """Train a policy with TD3."""

    num_envs: int = 16
    """Number of environments that are simulated in parallel, each with a separate episode."""

    model = TD3
    settings = staticmethod(lambda envs, _: td3_settings(envs))


class Stages(BaseCallback):
    """Divide a training into stages, and evaluate and save the model after each of them.

    A stage begins with new episodes and random generators that are seeded by its number. It depends only on this number
    and the state before it, so an interrupted run has the same learning curve. A stage ends with the first rollout that
    has its steps.

    Parameters
    ----------
    run
        Folder of the run.
    envs
        Environments of the training.
    model
        Model, which is set to the state of the run's checkpoint if there is one.
    """

    def __init__(self, run: Run, envs: RowVecEnv, model: BaseAlgorithm):
        super().__init__()
        self.run, self.envs, self.cfg = run, envs, run.config
        self.validate = Validation(run.scenarios, self.cfg.validation_episodes)
        self.rows_per_step = envs.rows_per_env / envs.rows.action_repeat
        """Steps as Stable-Baselines3 counts them for each step of an environment."""
        self.stage, self.best = 0, math.inf
        self.advance: Callable[..., None] = lambda *_: None
        if (state := run.load()) is not None:
            model.set_parameters(state["parameters"], exact_match=True, device=model.device)
            model.num_timesteps, model._n_updates = state["timesteps"], state["updates"]
            for name, values in stored_arrays(model).items():
                torch.as_tensor(values).copy_(state["arrays"][name])
            self.stage, self.best = state["stage"], state["best"]

    def _on_training_start(self) -> None:
        self._begin()

    def _on_rollout_start(self) -> None:
        if self.model.num_timesteps >= (self.stage + 1) * self.cfg.validate_every * self.rows_per_step:
            self._end()
            self._begin()

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self._end()

    def _begin(self) -> None:
        """Begin new episodes; no two stages, nor runs of other seeds, share one."""
        set_random_seed((self.cfg.seed * 1_000_003 + self.stage) % 2**32)
        self.envs.seed((self.cfg.seed << 40) + self.stage * self.envs.n_envs)
        self.model._last_obs = self.envs.reset()
        self.model._last_episode_starts = np.ones(self.envs.num_envs, bool)

    def _end(self) -> None:
        """Evaluate the policy, keep it if it is the best, and write a checkpoint."""
        run, model = self.run, self.model
        self.stage += 1
        run.step = round(model.num_timesteps / self.rows_per_step)
        run.require_finite("a parameter is", model.policy.parameters())
        logged = {name: float(value) for name, value in model.logger.name_to_value.items()}
        for name, value in logged.items():
            if not math.isfinite(value):
                raise run.diverged(f"{name} is")
        policy = to_policy(model, self.envs.scenario)
        policy.trained_on = trained_on(self.cfg)
        figures = self.validate(policy)
        if figures["J"] < self.best:
            self.best = figures["J"]
            run.keep(policy, self.best)
        run.record(figures | {"J_best": self.best, "env_steps": run.step} | logged)
        run.save(
            {"parameters": model.get_parameters(), "timesteps": model.num_timesteps, "updates": model._n_updates,
             "arrays": {name: torch.as_tensor(values) for name, values in stored_arrays(model).items()},
             "stage": self.stage, "best": self.best}
        )  # fmt: skip
        self.advance(self.stage, f"J {figures['J']:.4f}, droop {self.validate.j_droop:.4f}")


def stored_arrays(model: Any) -> dict[str, Any]:
    """Return tensors and arrays of a checkpoint that are not parameters of the model, to read or to overwrite.

    They are the content of the replay buffer, whose position is set by the steps done, and what the algorithm learns
    besides networks.
    """
    _, names = model._get_torch_save_params()
    arrays = {name: getattr(model, name).data for name in names}
    if (buffer := getattr(model, "replay_buffer", None)) is None:
        return arrays
    stored = model.num_timesteps // buffer.n_envs
    buffer.pos, buffer.full = stored % buffer.buffer_size, stored >= buffer.buffer_size
    return arrays | {name: getattr(buffer, name) for name in REPLAY}


def vec_env_for(cfg: StableBaselines3) -> RowVecEnv:
    """Return the environments of the training; raise ValueError if a setting is invalid."""
    check(cfg)
    spec = ScenarioSpec(cfg.scenario, cfg.set)
    scenario = under_own_control(spec.make("train"), keep_set_points=True)
    make_controller("droop-tuned", spec.make("validation"))  # ValueError where it has no gains, before all the work
    overrides: dict[str, Any] = {} if cfg.reward is None else {"reward": cfg.reward}
    return sb3_vec_env(scenario, cfg.num_envs, cfg.view, outputs=cfg.outputs, **overrides)


def make(cfg: StableBaselines3, envs: RowVecEnv) -> BaseAlgorithm:
    """Return the initialised algorithm."""
    model = cfg.model(env=envs, seed=cfg.seed, **(cfg.settings(envs, cfg.steps) | {"device": cfg.device}))
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def main(cfg: StableBaselines3) -> Path:
    """Train a policy and return the output folder.

    Raises
    ------
    TrainingError
        If the training in the folder cannot be continued, or parameters or losses are not finite; the previous
        checkpoint is kept.
    ValueError
        If a setting is invalid.
    """
    device_of(cfg.device)
    torch.set_num_threads(cfg.threads)
    envs = vec_env_for(cfg)
    judged_on = ScenarioSpec(cfg.scenario, cfg.set).make("validation")
    with open_run(cfg.folder, cfg, cfg.resume, [judged_on]) as run:
        model = make(cfg, envs)
        stages = Stages(run, envs, model)
        n_stages, left = -(-cfg.steps // cfg.validate_every), round(cfg.steps * stages.rows_per_step)
        left -= model.num_timesteps
        with progress(f"{cfg.scenario}, {cfg.model.__name__}", n_stages, stages.stage) as stages.advance:
            try:
                if left > 0:
                    model.learn(left, stages, log_interval=None, reset_num_timesteps=False)  # pyright: ignore
            except ValueError:  # Stable-Baselines3's for a distribution
                run.require_finite("a parameter is", model.policy.parameters())
                raise
        finish(run)
    print(
        f"{run.folder}: best on validation {stages.best:.4f}, droop {stages.validate.j_droop:.4f}, {run.seconds:.0f} s"
    )
    return run.folder
