"""Train a policy by gradients through the power flow.

The algorithm needs no value function and no exploration. It simulates episodes with the environment's ``dynamics.step``
(``TensorEnv``), cuts them into windows, and takes a gradient step on the cost of each window (truncated
back-propagation through time):

    loss = mean cost c_t over the window's steps and episodes  +  end-of-episode cost at the window's end / steps

A limit on the delay or the violation multiplies its price by a factor. It begins at 1, rises while the limit is
exceeded and falls while it is kept (dual ascent: C. Tessler, D. Mankowitz and S. Mannor, "Reward constrained policy
optimization", arXiv 1805.11074).

Each kind of agent has one network. It uses local observations only, and its outputs are changes from the action that
keeps the current state (``policy.interface``). Agents of one kind differ only in their electrical distance R_ii, X_ii
and their rating.

The mean delay is differentiable because Little's law gives it as mean backlog divided by mean arriving work.

Reference: J. Xu et al., "Accelerated policy learning with parallel differentiable simulation", arXiv 2204.07137.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import RandomFeeders, Scenario, TensorEnv, TensorStep, TripWidths, end_costs, under_own_control
from dcgrid_env.agents.policy.history_network import outputs_of
from dcgrid_env.agents.policy.interface import PolicyInterface, require_one_policy_fits
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.config import NetworkTraining, check, scenarios, trained_on
from dcgrid_env.agents.training.normalisation import episode_seeds, normalisation, remembered_columns
from dcgrid_env.agents.training.run_folder import Run, device_of, open_run, torch
from dcgrid_env.agents.training.torch_modules import (
    HistoryPerceptron,
    Perceptron,
    cosine,
    forgiving_clip,
    without_overflow,
)
from dcgrid_env.agents.training.training_loop import train
from dcgrid_env.agents.training.validation import Validation, made_with, stepped

SMALLEST_FACTOR, LARGEST_FACTOR = 1e-3, 1e3


class Limits(NamedTuple):
    """Limits that a policy must meet while it minimises the other costs; None for no limit."""

    delay_s: float | None
    """Mean delay, s."""
    violation_pu: float | None
    """Mean excess of the voltage over the band, p.u."""

    def merit(self, figures: Mapping[str, float]) -> float:
        """Return the selection criterion, smallest for the best policy: J without limited costs, with a penalty."""
        left, beyond = figures["J"], 0.0
        if self.delay_s is not None:
            left -= figures["J_waiting"]
            beyond += max(figures["delay_mean_s"] / self.delay_s - 1.0, 0.0)
        if self.violation_pu is not None:
            left -= figures["J_violation"]
            beyond += max(figures["excess_mean_pu"] / self.violation_pu - 1.0, 0.0)
        return left * (1.0 + 10.0 * beyond)


def updated_factor(factor: float, limit: float | None, measured: float, rate: float) -> float:
    """Update a price factor in proportion to ``rate`` and the relative distance from its limit.

    Without a limit the factor does not change.
    """
    if limit is None:
        return factor
    off = min(max(measured / limit - 1.0, -1.0), 1.0)
    return min(max(factor * math.exp(rate * off), SMALLEST_FACTOR), LARGEST_FACTOR)


@dataclass(frozen=True)
class Analytic(NetworkTraining):
    """Train a policy by gradients through the grid."""

    delay_limit_s: float | None = None
    """Upper limit on the mean delay, s. The price of waiting is then adapted to meet the limit."""
    violation_limit_pu: float | None = None
    """Upper limit on the mean excess over the voltage band, p.u. The price of violations is then adapted to meet it."""
    vary: int = 0
    """Number of additional variants of each scenario to train on, with other placements, ratings and substation
    voltages."""
    updates: int = 200
    """Number of optimiser steps."""
    window: int = 40
    """Approximate number of simulation steps through which gradients are propagated."""
    learning_rate: float = 1e-2
    """Initial learning rate; it decays to zero along a cosine."""
    max_grad_norm: float = 1.0
    """Maximum norm of the gradient; larger gradients are scaled down."""
    history: int = 0
    """Number of past steps whose changes in voltage, power and coming work are network inputs; 0 for none."""
    trip_width_pu: float = 0.0
    """Width, p.u. of voltage, of the smooth steps that replace disconnection and reconnection in the gradient. With 0
    the gradient ignores both (docs/ride-through.md)."""
    trip_width_s: float = 1.0
    """Width, s, of the smooth steps in the time until a slow trip."""
    dual_rate: float = 0.05
    """Step size of the price factor of a limit: relative change per relative excess over the limit."""
    validate_every: int = 8
    """Batches of episodes between validations."""
    checkpoint_every: int = 8
    """Batches of episodes between checkpoints."""

    @property
    def limits(self) -> Limits:
        """Limits that the policy must meet."""
        return Limits(self.delay_limit_s, self.violation_limit_pu)

    @property
    def trip_widths(self) -> TripWidths | None:
        """Widths of the smooth steps for disconnection and reconnection; None if they are not used."""
        return TripWidths(self.trip_width_pu, self.trip_width_s) if self.trip_width_pu else None


class Learner:
    """Store networks, optimiser, price factors and training grids.

    Parameters
    ----------
    cfg
        The configuration.
    grids
        Scenarios of the training split, with observations of the same widths.
    """

    def __init__(self, cfg: Analytic, grids: Sequence[Scenario]):
        self.cfg, self.device = cfg, device_of(cfg.device)
        kind = "shared" if cfg.view == "shared" else "joint"
        self.chosen: dict[str, Any] = {
            "preview": cfg.preview,
            "act": cfg.act,
            "nameplate": True,
            "outputs": "change",
        }
        like, widths = torch.empty(0, device=self.device), cfg.trip_widths
        self.envs = [TensorEnv(grid, like=like, trip_widths=widths) for grid in grids]
        made_for = {**self.chosen, "array": self._tensor, "clip": forgiving_clip}
        self.interfaces = [PolicyInterface(grid, kind, **made_for) for grid in grids]
        require_one_policy_fits(self.interfaces)
        self.factors = {"delay": 1.0, "violation": 1.0}
        torch.manual_seed(cfg.seed)
        self.memory: dict[str, tuple[torch.Tensor, ...]] = {}
        self.columns = remembered_columns(self.interfaces) if cfg.history else {}
        moments = normalisation(self.envs, self.interfaces, cfg.seed, self._tensor, self.columns, cfg.history)
        widths = {name: both for interface in self.interfaces for name, both in interface.widths.items()}
        networks = {name: self.network(name, *moments[name], widths[name][1]) for name in widths}
        self.networks = torch.nn.ModuleDict(networks).to(self.device)
        self.optimiser = torch.optim.Adam(self.networks.parameters(), lr=cfg.learning_rate)

    def network(self, name: str, mean: torch.Tensor, std: torch.Tensor, n_out: int) -> torch.nn.Module:
        """Return an initialised network for agents of this kind."""
        if self.columns.get(name):
            return HistoryPerceptron(mean, std, n_out, self.cfg.hidden, self.columns[name], self.cfg.history)
        return Perceptron(mean, std, n_out, self.cfg.hidden)

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.array(array)).to(self.device)

    def episodes(
        self, i: int, iteration: int, require_finite: Callable[[str, Iterable[torch.Tensor]], None]
    ) -> dict[str, float]:
        """Simulate a batch of episodes on grid i and update the networks after each window.

        ``require_finite`` raises if tensors are not finite; its first argument describes them.
        """
        cfg, env = self.cfg, self.envs[i]
        joint = env.reset(episode_seeds(cfg.seed, iteration, cfg.num_envs))
        self.memory = {}
        losses, norm, excess_pu = [], 0.0, 0.0
        waited, arrived = torch.zeros(2, cfg.num_envs, device=self.device)
        for size in windows(env.scenario.horizon, cfg.window):
            total, step = torch.zeros((), device=self.device), None
            for _ in range(size):
                step = env.step(without_overflow(self.act(i, joint)))
                joint = step.observation
                total = total + self._priced(env, step)
                waited = waited + step.state.backlog_kws.detach().sum(-1)
                arrived = arrived + step.state.arrived_kw.detach().sum(-1)
                excess_pu += float(step.costs.violation.detach().mean()) / (env.scenario.cost.weights.violation or 1.0)
            assert step is not None
            loss = (total + self._left(env, step)) / size
            self.optimiser.zero_grad()
            loss.backward()
            norm = float(torch.nn.utils.clip_grad_norm_(self.networks.parameters(), cfg.max_grad_norm))
            weights = list(self.networks.parameters())
            require_finite("a gradient is", (weight.grad for weight in weights if weight.grad is not None))
            self.optimiser.step()
            require_finite("a weight is", weights)
            env.cut()
            joint = joint.detach()
            self.memory = {name: tuple(a.detach() for a in state) for name, state in self.memory.items()}
            losses.append(float(loss.detach()))
        delay_s = float((waited / arrived.clamp(min=1e-9)).mean())  # of each episode, as it is judged
        measured = {"delay": delay_s, "violation": excess_pu / env.scenario.horizon}
        for name, limit in zip(measured, cfg.limits, strict=True):
            self.factors[name] = updated_factor(self.factors[name], limit, measured[name], cfg.dual_rate)
        return {"loss": float(np.mean(losses)), "gradient_norm": norm}

    def _priced(self, env: TensorEnv, step: TensorStep) -> torch.Tensor:
        """Return the mean cost of a step with the price factors, without costs charged only at the end."""
        c, f = step.costs, self.factors
        each = step.cost_j - c.leftover + (f["delay"] - 1.0) * c.backlog + (f["violation"] - 1.0) * c.violation
        for name in self._further_end_costs(env, step) if env.over else ():
            each = each - getattr(c, name)
        return each.mean()

    def _left(self, env: TensorEnv, step: TensorStep) -> torch.Tensor:
        """Return the end-of-episode cost at a window's end: backlog and other costs charged only at the end."""
        rated_kw, weight = (
            float(env.scenario.datacenters.parameters.p_rated_kw.sum()) or 1.0,
            env.scenario.cost.weights.leftover,
        )
        due = self.factors["delay"] * weight * step.state.backlog_kws.sum(-1).mean() / rated_kw
        return due + sum(further.mean() for further in self._further_end_costs(env, step).values())

    @staticmethod
    def _further_end_costs(env: TensorEnv, step: TensorStep) -> dict[str, torch.Tensor]:
        """Return end-of-episode costs other than backlog, such as energy missing in storages, each (row,)."""
        return {name: due for name, due in end_costs(env.scenario, step.state).items() if name != "leftover"}

    def act(self, i: int, joint: torch.Tensor) -> torch.Tensor:
        """Return the joint action for a joint observation of grid i."""
        interface = self.interfaces[i]
        return interface.action(joint, outputs_of(self.networks, interface.inputs(joint), self.memory))  # pyright: ignore

    @property
    def iterations(self) -> int:
        """Batches of episodes in the training."""
        each = np.mean([len(windows(env.scenario.horizon, self.cfg.window)) for env in self.envs])
        return max(1, round(self.cfg.updates / each))

    def iterate(self, iteration: int, run: Run) -> dict[str, float]:
        """Train on a batch of episodes of the next grid, and return figures for the learning curve."""
        for group in self.optimiser.param_groups:
            group["lr"] = cosine(self.cfg.learning_rate, iteration, self.iterations)
        figures = self.episodes((iteration - 1) % len(self.envs), iteration, run.require_finite)
        figures |= {f"{name}_factor": value for name, value in self.factors.items()}
        return figures | stepped([env.scenario for env in self.envs], self.cfg.num_envs, iteration)

    def state(self) -> dict[str, Any]:
        """Return the state from which training can continue."""
        return {
            "networks": self.networks.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "factors": self.factors,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a state that ``state()`` returned."""
        self.networks.load_state_dict(state["networks"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.factors = state["factors"]

    def policy(self) -> Policy:
        """Return the current policy as NumPy arrays."""
        networks = {name: net.exported() for name, net in self.networks.items()}  # pyright: ignore
        return Policy(
            networks, observe=self.cfg.observe, **self.chosen, scenario=trained_on(self.cfg), made_with=made_with(),
            channels={name: channels for view in self.interfaces for name, channels in view.further_channels.items()},
        )  # fmt: skip


def variant(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """Return the scenario with other placements, ratings and substation voltage.

    Data centres are placed at random in each episode, with 0.5 to 1.1 times their rating. Inverters are placed at other
    load buses, with 0.5 to 2 times their rating. The substation voltage changes by up to 0.01 p.u.
    """
    if isinstance(scenario.feeder, RandomFeeders):
        raise ValueError(f"vary: {scenario.name} has another feeder in each batch by itself; leave vary out")
    feeder, n_inv = scenario.feeder, scenario.inverters.count
    load_kw = np.bincount(feeder.node_bus[feeder.leg_node], feeder.p_load_kw, feeder.n_bus)
    loaded = [bus for i, bus in enumerate(feeder.bus_ids) if load_kw[i] > 0 and _has_phases(scenario, i)][1:]
    chosen = rng.choice(len(loaded), n_inv, replace=False)
    return scenario.replace(
        datacenters={
            "buses": None,
            "p_rated_kw": tuple(
                scenario.datacenters.parameters.p_rated_kw * rng.uniform(0.5, 1.1, scenario.datacenters.count)
            ),
        },
        inverters={
            "buses": tuple(loaded[i] for i in sorted(chosen)),
            "s_rated_kva": tuple(scenario.inverters.parameters.s_rated_kva * rng.uniform(0.5, 2.0, n_inv)),
        },
        source_voltage_pu=float(scenario.source_voltage_pu + rng.uniform(-0.01, 0.01)),
    )


def _has_phases(scenario: Scenario, position: int) -> bool:
    """Whether the bus at a position has all phases that inverters of the scenario are connected to."""
    needed = {phase for phases in scenario.inverters.phases or () for phase in phases}
    return not needed or needed <= set(scenario.feeder.bus_phases[position])


def check_batch(scenarios: Sequence[Scenario], num_envs: int) -> None:
    """ValueError, naming the field, unless a batch of episodes is on one feeder where feeders are random."""
    for scenario in scenarios:
        if isinstance(scenario.feeder, RandomFeeders) and scenario.feeder.batch % num_envs:
            batch = scenario.feeder.batch
            raise ValueError(
                f"num_envs is {num_envs}; {scenario.name} has another feeder after each {batch} episodes, and "
                f"gradients are of one feeder at a time: give {batch} or a divisor of it"
            )


def windows(horizon: int, window: int) -> list[int]:
    """Lengths of an episode's windows, as equal as they come and about as long as asked."""
    n = max(1, round(horizon / window))
    return [(horizon * (k + 1)) // n - (horizon * k) // n for k in range(n)]


def grids_of(cfg: Analytic) -> list[Scenario]:
    """Return the named training scenarios and their variants; raise ValueError if one is invalid."""
    given = [under_own_control(grid) for grid in scenarios(cfg.scenario, cfg.set, observe=cfg.observe)]
    check_batch(given, cfg.num_envs)
    rng = np.random.default_rng([cfg.seed, 1])
    return given + [variant(grid, rng) for _ in range(cfg.vary) for grid in given]


def main(cfg: Analytic, learner: type[Learner] = Learner) -> Path:
    """Train a policy and return the output folder."""
    check(cfg)
    torch.set_num_threads(cfg.threads)
    grids = grids_of(cfg)
    if cfg.violation_limit_pu is not None and not all(grid.cost.weights.violation > 0 for grid in grids):
        raise ValueError("violation_limit_pu: the violation has weight 0 in a scenario; its price cannot be found")
    model = learner(cfg, grids)
    judged_on = scenarios(cfg.scenario, cfg.set, "validation")
    validate = Validation(judged_on, cfg.validation_episodes)
    with open_run(cfg.folder, cfg, cfg.resume, judged_on) as run:
        return train(
            run, model, model.iterations, validate, ("droop", validate.j_droop), merit=cfg.limits.merit, scenarios=grids
        )
