"""Train a policy with the cross-entropy method (CEM), a random search without gradients.

Each iteration draws candidates, the parameters of small networks, from a normal distribution. All candidates run
through the same episodes of the training split, each in some rows of one native batch. The distribution moves to the
candidates of least cost (``core.cross_entropy``).

The method needs no model and no credit assignment: a candidate's cost is the cost of complete episodes. Use it if
actions have effects many steps later that gradients and value functions miss, such as the taps of regulators, which
move 15 to 30 s after the voltage. It is made for networks of few parameters.

Network outputs are changes from the action that keeps the current state (``policy.interface``), with
``outputs="droop"`` corrections of the tuned droop, or with ``outputs="constant"`` deviations from a constant reactive
power of each agent. They are 0 for the initial mean.

If agents choose set points of regulators and capacitor banks, the candidates also have constant offsets, half bands
and centres of thresholds. The initial mean is the default, or with ``outputs="constant"`` the tuned law ``static``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dcgrid_env import DcgridVectorEnv, Scenario, TensorEnv, under_own_control
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.candidates import Candidates
from dcgrid_env.agents.training.config import NetworkTraining, check, trained_on
from dcgrid_env.agents.training.normalisation import episode_seeds, normalisation
from dcgrid_env.agents.training.row_form import droop_gains
from dcgrid_env.agents.training.run_folder import Run, open_run, torch
from dcgrid_env.agents.training.training_loop import train
from dcgrid_env.agents.training.validation import Validation, made_with, stepped
from dcgrid_env.baselines.laws.constant_set_points import agents_choose_set_points
from dcgrid_env.baselines.laws.static import ConstantQ
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.tuning.tuned import tuned_controller
from dcgrid_env.core.cross_entropy import CrossEntropy


@dataclass(frozen=True)
class Cem(NetworkTraining):
    """Train a policy with the cross-entropy method."""

    num_envs: int = 256
    """Number of environments that are simulated in parallel; a multiple of the population. Each candidate controls
    num_envs / population episodes, the same ones for all candidates of an iteration."""
    population: int = 128
    """Number of candidates in each iteration."""
    elites: int = 16
    """Number of candidates of least cost that determine the next distribution."""
    iterations: int = 100
    """Number of iterations."""
    std: float = 0.3
    """Initial standard deviation of the parameters."""
    extra_std: float = 0.03
    """Standard deviation that is added to that of the elites; it decreases linearly to zero at 70 % of the
    iterations."""
    outputs: Literal["change", "droop", "constant"] = "change"
    """Meaning of the network's outputs. change: q is a change of the current reactive power. droop: clock and q are
    corrections of the tuned droop. constant: q is a deviation from a constant of each agent, which is searched together
    with the network. The search then starts from the tuned law static, if agents choose set points, or constant-q."""
    hidden: tuple[int, ...] = (8,)
    """Widths of the hidden layers; empty for an affine function."""
    validate_every: int = 5
    """Iterations between validations."""


class Search:
    """Store the scenario, its environments and the distribution of the candidates.

    Parameters
    ----------
    cfg
        The configuration.
    grid
        Scenario of the training split, with agents of set points if it has any.
    """

    def __init__(self, cfg: Cem, grid: Scenario):
        self.cfg, self.grid, others = cfg, grid, under_own_control(grid)
        self.chosen: dict[str, Any] = {
            "preview": cfg.preview,
            "act": cfg.act,
            "nameplate": True,
            "outputs": cfg.outputs,
            "gains": droop_gains(grid) if cfg.outputs == "droop" else None,
        }
        kind = "shared" if cfg.view == "shared" else "joint"
        self.interface = PolicyInterface(others, kind, **self.chosen)
        seen = PolicyInterface(others, kind, **self.chosen, array=_tensor)
        env = TensorEnv(others, like=torch.empty(0))
        moments = {
            name: (mean.numpy(), std.numpy())
            for name, (mean, std) in normalisation([env], [seen], cfg.seed, _tensor, {}, 0).items()
        }
        self.candidates = Candidates(self.interface, moments, cfg.hidden, grid, _law(cfg, grid))
        start = self.candidates.start(np.random.default_rng([cfg.seed, 0]))
        self.distribution = CrossEntropy(start, cfg.std, cfg.extra_std, cfg.elites)
        self.batch = DcgridVectorEnv(cfg.num_envs, grid, info="none")

    def iterate(self, iteration: int, _: Run) -> dict[str, float]:
        """Evaluate candidates, move the distribution, and return figures for the learning curve."""
        cfg, distribution = self.cfg, self.distribution
        parameters = distribution.candidates(np.random.default_rng([cfg.seed, iteration]), cfg.population)
        seeds = episode_seeds(cfg.seed, iteration, cfg.num_envs // cfg.population)
        j = self.candidates.costs(parameters, self.batch, seeds).mean(1)
        distribution.update(parameters, j, iteration / cfg.iterations)
        figures = {"J_training": float(j[0]), "J_training_best": float(j.min()), "std": float(distribution.std.mean())}
        return figures | stepped([self.grid], cfg.num_envs, iteration)

    def policy(self) -> Policy:
        """Return the policy of the mean."""
        mean = self.distribution.mean.astype(np.float32)
        shares = self.candidates.q_share(mean)
        return Policy(
            self.candidates.networks(mean), observe=self.cfg.observe, **self.chosen,
            scenario=trained_on(self.cfg), made_with=made_with(), channels=self.interface.further_channels,
            set_points=self.candidates.set_points(mean), q_share=None if shares is None else shares.tolist(),
        )  # fmt: skip

    def state(self) -> dict[str, Any]:
        """Return the state from which the search can continue."""
        return {name: torch.from_numpy(getattr(self.distribution, name)) for name in ("mean", "std")}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state that ``state()`` returned."""
        self.distribution.mean, self.distribution.std = (state[name].numpy() for name in ("mean", "std"))


def _law(cfg: Cem, grid: Scenario) -> ConstantQ | None:
    """Return the tuned law from whose constants the search starts; None to start without one."""
    if cfg.outputs != "constant":
        return None
    law = tuned_controller("static" if agents_choose_set_points(grid) else "constant-q", grid)
    assert isinstance(law, ConstantQ)
    return law


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.array(array))


def grid_of(cfg: Cem) -> Scenario:
    """Return the scenario of the training split; raise ValueError if a setting or the scenario is invalid."""
    check(cfg)
    if cfg.device != "cpu":
        raise ValueError(f"device is {cfg.device!r}; {cfg.algorithm()} runs on the CPU alone: leave it out")
    if cfg.num_envs % cfg.population:
        raise ValueError(f"num_envs is {cfg.num_envs}; give a multiple of the population, {cfg.population}")
    if not 2 <= cfg.elites <= cfg.population:
        raise ValueError(f"elites is {cfg.elites}; give at least 2 and at most the population, {cfg.population}")
    spec = ScenarioSpec(cfg.scenario, cfg.set)
    grid = under_own_control(spec.make("train", observe=cfg.observe, reward="shared"), keep_set_points=True)
    _law(cfg, grid)  # raise ValueError for a law that is not tuned
    return grid


def main(cfg: Cem) -> Path:
    """Train a policy and return the output folder."""
    grid = grid_of(cfg)
    torch.set_num_threads(cfg.threads)
    judged_on = ScenarioSpec(cfg.scenario, cfg.set).make("validation")
    validate = Validation([judged_on], cfg.validation_episodes)
    with open_run(cfg.folder, cfg, cfg.resume, [judged_on]) as run:
        return train(run, Search(cfg, grid), cfg.iterations, validate, ("droop", validate.j_droop))
