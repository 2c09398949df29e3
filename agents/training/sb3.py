"""Configuration, training split and training loop of the Stable-Baselines3 algorithms.

A run is a sequence of iterations. Each starts with new episodes and random generators seeded with the iteration number.
An iteration therefore depends only on its number and the previous state, and an interrupted run resumes with the same
learning curve.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.utils import set_random_seed

from dcgrid_env import Scenario, under_own_control
from dcgrid_env.agents.policy.interface import Gains
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.batched_envs import RowVecEnv
from dcgrid_env.agents.training.config import Training, check
from dcgrid_env.agents.training.row_form import Outputs, RowForm
from dcgrid_env.agents.training.row_views import make_rows
from dcgrid_env.agents.training.run_folder import Run, device_of, finish, open_run, progress, torch
from dcgrid_env.agents.training.validation import Validation
from dcgrid_env.baselines import make_controller
from dcgrid_env.baselines.scenario_spec import ScenarioSpec


@dataclass(frozen=True)
class Config(Training):
    """Settings of all Stable-Baselines3 algorithms."""

    reward: Literal["shared", "difference"] = "shared"
    """Reward of an agent: the team's, or the cost that its own action saves in the step, which needs --gamma 0 and
    uses the grid model in training."""
    nameplate: bool = False
    """Also observe the effect of full demand and full reactive power on the agent's voltage (shared policy)."""
    num_envs: int = 384
    """Approximate number of rows that Stable-Baselines3 steps in parallel. A row is an agent with a shared policy, an
    environment with a centralised one."""
    gamma: float = 0.9
    """Discount factor; the effective planning horizon is 1 / (1 - gamma) steps."""
    wait: float = 10.0
    """Waiting time, in steps, that costs the same with and without the discount. Larger values make deferral more
    expensive."""

    @classmethod
    def for_scenario(cls, scenario: str | None = None, view: str | None = None, **fields: Any) -> Self:
        """Return the configuration for a scenario, see :class:`Training`.

        The tuned settings are those of the team reward. With difference rewards the discount is 0 instead.
        """
        if fields.get("reward") != "difference":
            return super().for_scenario(scenario, view, **fields)
        chosen: dict[str, Any] = {"scenario": scenario or cls.scenario, "view": view or cls.view}
        return cls(**(cls.with_difference | chosen | fields))

    with_difference: ClassVar[dict[str, Any]] = {"gamma": 0.0, "nameplate": True}
    """Settings that suit difference rewards."""

    @property
    def kind(self) -> str:
        """Second part of the folder name: the algorithm, the reward unless shared, and whether it is centralised."""
        name = self.algorithm() if self.reward == "shared" else f"{self.algorithm()}-{self.reward}"
        return name if self.view == "shared" else f"{name}-centralised"


@dataclass(frozen=True)
class OffPolicy(Config):
    """Further settings of the algorithms with a replay buffer."""

    num_envs: int = 96
    """Approximate number of rows that Stable-Baselines3 steps in parallel. A row is an agent with a shared policy, an
    environment with a centralised one."""
    checkpoint_every: int = 50
    """Iterations between checkpoints, which contain the replay buffer."""
    steps: int = 1_000_000
    """Total number of steps: agent steps with a shared policy, environment steps with a centralised one."""
    learning_rate: float = 1e-3
    """Initial learning rate; it decays linearly to zero."""
    buffer: int = 200_000
    """Size of the replay buffer, in agent or environment steps."""
    batch: int = 512
    """Minibatch size, in agent or environment steps."""
    gradient_steps: int = 2
    """Gradient steps for each step of the vector environment."""
    tau: float = 0.01
    """Update rate of the target networks for each gradient step."""

    def iterations(self, vec_env: RowVecEnv) -> int:
        """Return the number of iterations for the total number of steps, at least 1."""
        return max(1, round(self.steps / (vec_env.num_envs * vec_env.scenario.horizon)))

    def rate(self, done: float) -> float:
        """Return the learning rate after this fraction of the training."""
        return self.learning_rate * (1.0 - done)


@contextmanager
def begin(cfg: Config, outputs: Outputs = "setpoint", gains: Gains | None = None) -> Iterator[tuple[Run, RowVecEnv]]:
    """Lock the folder of the run for the block and return the vector environment of the training split.

    Raise ValueError if a setting is invalid, and TrainingError if the training in the folder cannot be continued.
    """
    vec_env = vec_env_for(cfg, outputs, gains)
    with run_of(cfg) as run:
        yield run, vec_env


def run_of(cfg: Training) -> AbstractContextManager[Run]:
    """Lock the folder of the run for the block; raise TrainingError if the training in it cannot be continued."""
    judged_on = ScenarioSpec(cfg.scenario, cfg.set).make("validation")
    return open_run(cfg.folder, cfg, cfg.resume, [judged_on])


def vec_env_for(cfg: Config, outputs: Outputs = "setpoint", gains: Gains | None = None) -> RowVecEnv:
    """Return the vector environment of the training split; raise ValueError if a setting is invalid."""
    check(cfg)
    has_differences = cfg.reward == "difference"
    if has_differences and cfg.gamma != 0.0:
        raise ValueError(
            f"gamma is {cfg.gamma}; a difference reward charges later costs at once: give gamma 0, or reward shared"
        )
    device_of(cfg.device)
    torch.set_num_threads(cfg.threads)
    spec = ScenarioSpec(cfg.scenario, cfg.set)
    scenario = under_own_control(spec.make("train", observe=cfg.observe, reward="shared"), keep_set_points=True)
    scenario = scenario.replace(sensing={"preview": scenario.sensing.preview and cfg.preview})
    if has_differences:
        default = "droop" if outputs == "droop" else "previous"  # what an action of 0 does
        scenario = scenario.replace(cost={"reward": "difference", "default_action": default})
    else:
        scenario = for_training(scenario, cfg.gamma, cfg.wait)
    make_controller("droop-tuned", spec.make("validation"))  # ValueError where it has no gains, before all the work
    if cfg.view == "centralised":
        form, n_envs = RowForm("joint", outputs, gains=gains), cfg.num_envs
    else:
        form = RowForm("shared", outputs, cfg.nameplate, gains)
        n_envs = max(1, cfg.num_envs // scenario.n_agents)
    vec_env = RowVecEnv(make_rows(scenario, form, cfg.act), n_envs)
    vec_env.end_as_it_arises = not has_differences
    return vec_env


def for_training(scenario: Scenario, gamma: float, wait: float) -> Scenario:
    """Return the scenario with a backlog price for policies that do not observe time and use a discount.

    For a policy that does not observe time, each of the T steps is equally likely to be the last, where a second of
    backlog costs ``leftover``. Each step therefore charges ``leftover / T`` more, the same on average, instead of one
    large unpredictable charge at the end. The horizon then only truncates an episode, and values are bootstrapped.

    A discount reduces the cost of long waiting and would make deferral too attractive. Waiting n steps costs n without
    and (1 - gamma^n) / (1 - gamma) with the discount. The price is raised by the ratio of the two at n = ``wait``.

    Other end-of-episode costs, such as energy missing in storages, are charged by the rows when they arise
    (``RowVecEnv.end_as_it_arises``).
    """
    w = scenario.cost.weights
    raised = wait * (1.0 - gamma) / (1.0 - gamma**wait) if gamma < 1.0 else 1.0
    return scenario.replace(
        weights=w._replace(backlog=raised * (w.backlog + w.leftover / scenario.horizon), leftover=0.0)
    )


def episode_seed(seed: int, iteration: int, n_envs: int) -> int:
    """Return the seed of the first environment's episode in an iteration; iterations and runs have different seeds."""
    return (seed << 40) + iteration * n_envs


def train(
    cfg: Training,
    run: Run,
    vec_env: RowVecEnv,
    model: BaseAlgorithm,
    *,
    iterations: int,
    exported: Callable[[], Policy],
    learning_rate: Callable[[float], float],
    extra: Callable[[], Mapping[str, Any]] = dict,
) -> Path:
    """Train a model, with one episode of every row in each iteration, and return the output folder.

    Parameters
    ----------
    cfg, run, vec_env, model
        Results of :func:`begin` and the algorithm.
    iterations
        Total number, including those of an interrupted run.
    exported
        Function that returns the current policy.
    learning_rate
        Learning rate as a function of the completed fraction of the training.
    extra
        Further checkpoint contents, in addition to networks and optimisers: arrays and tensors, restored in place.

    Raises
    ------
    TrainingError
        If parameters or losses are not finite; the previous checkpoint is kept.
    """
    judged_on = ScenarioSpec(cfg.scenario, cfg.set).make("validation")
    validate, state = Validation([judged_on], cfg.validation_episodes), run.load()
    best, done, spent = math.inf, 0, np.zeros(3)
    if state is not None:
        model.set_parameters(state["parameters"], exact_match=True, device=model.device)
        model.num_timesteps, model._n_updates = run.step, state["updates"]
        for name, values in extra().items():
            torch.as_tensor(values).copy_(state["extra"][name])
        best, done, spent = state["best"], state["iteration"], np.array(state["spent_s"])
    with progress(f"{cfg.scenario}, {type(model).__name__}", iterations, done) as advance:
        for iteration in range(done + 1, iterations + 1):
            began_s, vec_env.physics_s = time.perf_counter(), 0.0
            _iterate(run, vec_env, model, cfg.seed, iteration, learning_rate((iteration - 1) / iterations))
            spent += (vec_env.physics_s, time.perf_counter() - began_s - vec_env.physics_s, 0.0)
            run.step, text = model.num_timesteps, ""
            if iteration % cfg.validate_every == 0 or iteration == iterations:
                began_s = time.perf_counter()
                policy = exported()
                figures = validate(policy)
                if figures["J"] < best:
                    best = figures["J"]
                    run.keep(policy, best, judged_on)
                spent[2] += time.perf_counter() - began_s
                stepped = {"env_steps": run.step // vec_env.rows_per_env}
                run.record(figures | {"J_best": best} | stepped | logged(model) | timing(run.step, spent))
                text = f"J {figures['J']:.4f}, droop {validate.j_droop:.4f}"
            if iteration % cfg.checkpoint_every == 0 or iteration == iterations:
                run.save(
                    {"parameters": model.get_parameters(), "iteration": iteration, "best": best,
                     "spent_s": spent.tolist(), "updates": model._n_updates,
                     "extra": {name: torch.as_tensor(values) for name, values in extra().items()}}
                )  # fmt: skip
            advance(iteration, text)
    finish(run)
    print(f"{run.folder}: J {best:.4f} on validation, tuned droop {validate.j_droop:.4f}")
    print(", ".join(f"{name} {value:,.3g}" for name, value in timing(run.step, spent).items()))
    return run.folder


def _iterate(run: Run, vec_env: RowVecEnv, model: BaseAlgorithm, seed: int, iteration: int, rate: float) -> None:
    """Run one episode of every row and learn from it."""
    set_random_seed((seed * 1_000_003 + iteration) % 2**32)
    vec_env.seed(episode_seed(seed, iteration, vec_env.n_envs))
    model._last_obs = None  # so that it begins with a reset
    model.lr_schedule = lambda _: rate
    steps = vec_env.num_envs * vec_env.scenario.horizon
    try:
        model.learn(steps, reset_num_timesteps=False, log_interval=None)  # pyright: ignore[reportArgumentType]
    except ValueError:
        run.require_finite("a parameter is", model.policy.parameters())
        raise
    run.step = model.num_timesteps
    run.require_finite("a parameter is", model.policy.parameters())
    for name, value in logged(model).items():
        if not math.isfinite(value):
            raise run.diverged(f"{name} is")


def logged(model: BaseAlgorithm) -> dict[str, float]:
    """Return the last values that the algorithm logged."""
    return {name: float(value) for name, value in model.logger.name_to_value.items()}


def timing(steps: int, spent_s: np.ndarray) -> dict[str, float]:
    """Return computing times and the step rate, which includes physics and learning but not validation."""
    physics_s, learning_s, validation_s = spent_s
    return {
        "physics_s": physics_s,
        "learning_s": learning_s,
        "validation_s": validation_s,
        "steps_per_s": steps / max(physics_s + learning_s, 1e-9),
    }
