"""Train corrections of the model-aided law on random feeders, for use on new feeders.

Each scenario of a batch comes from ``training.drawn_feeders`` and differs in feeder, placement, number and rating of
devices, substation voltage and work. Agents are commissioned as for the law (``baselines.model_aided``). The networks
correct the law (``policy.law_interface``); their initial corrections are zero. The gradient of the cost of complete
episodes passes through the grid and the law (``policy.law_step``):

    loss = mean over the batch's scenarios of log(J)

The logarithm gives difficult and easy feeders the same weight. Small batches of feeders differ much from each other.
Therefore a moving average of the weights is validated and saved, not the weights of one update. The saved policy has
the smallest mean J on held-out scenarios of the same family. Training uses none of the presets' feeders.

Reference: B. T. Polyak and A. B. Juditsky, SIAM J. Control Optim. 30(4), 1992.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dcgrid_env import Scenario, TensorEnv
from dcgrid_env.agents.policy.law_interface import FEATURES, OUTPUTS, LawInterface
from dcgrid_env.agents.policy.law_step import Past
from dcgrid_env.agents.policy.model_aided_policy import ModelAidedPolicy
from dcgrid_env.agents.training.config import NetworkTraining, check
from dcgrid_env.agents.training.drawn_feeders import FAMILY, drawn_scenario
from dcgrid_env.agents.training.run_folder import Run, finish, open_run, progress, torch
from dcgrid_env.agents.training.torch_modules import Perceptron, forgiving_clip
from dcgrid_env.agents.training.validation import made_with
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of

_NORMALISED_ON = 16
"""Number of scenarios for input normalisation: the last ones of a training seed, which training does not use."""
_OF_A_SEED = 1 << 24
"""Number of scenarios for each training seed."""
_LEAST_STD = 2e-2
_KEPT = 0.97
"""Decay of the moving average of the weights."""


@dataclass(frozen=True)
class CarryOver(NetworkTraining):
    """Train a policy for new feeders."""

    scenario: str = FAMILY
    """Family of scenarios on random feeders; the only allowed value is the default."""
    updates: int = 300
    """Number of optimiser steps."""
    feeders: int = 6
    """Number of scenarios in a batch, each on a different feeder."""
    num_envs: int = 8
    """Number of episodes for each scenario of a batch."""
    steps: int = 60
    """Length of a training episode, in steps. Gradients pass through the complete episode. Validation episodes have 120
    steps."""
    learning_rate: float = 3e-3
    """Initial learning rate; it decays to zero along a cosine."""
    max_grad_norm: float = 0.3
    """Maximum norm of the gradient; larger gradients are scaled down."""
    hidden: tuple[int, ...] = (48, 48)
    """Widths of the hidden layers."""
    validation_feeders: int = 16
    """Number of held-out scenarios on which a policy is evaluated."""
    validation_episodes: int = 4
    """Number of episodes for each held-out scenario."""
    validate_every: int = 25
    """Updates between validations."""
    checkpoint_every: int = 25
    """Updates between checkpoints."""

    @property
    def subject(self) -> str:
        """First part of the folder name: the scenario family."""
        return FAMILY

    @classmethod
    def algorithm(cls) -> str:
        """Name of the algorithm on the command line."""
        return "carry-over"


class CommissionedEnv:
    """Simulate differentiable episodes of a scenario with fixed placements and commissioned agents.

    Raises ValueError if the law cannot control the scenario.
    """

    def __init__(self, scenario: Scenario):
        site, s = site_of(scenario), scenario
        buses = [s.feeder.index(bus) for device in s.devices for bus in device.buses or ()]
        known = commission(site, np.array([buses]))
        self.interface = LawInterface(site, known, array=tensor, clip=forgiving_clip, tops=False)
        self.env = TensorEnv(scenario, like=torch.empty(0))

    def episodes(
        self, networks: Mapping[str, torch.nn.Module] | None, seeds: Sequence[int]
    ) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Return the mean J of the seeds' episodes and the network inputs; without networks, the law acts alone."""
        env, past, seen_by = self.env, Past(), {}
        joint, total = env.reset(seeds), torch.zeros(())
        while not env.over:
            step, seen = self.interface.figures(joint, past)
            outputs = {}
            for kind, inputs in seen.items():
                seen_by.setdefault(kind, []).append(inputs.detach().flatten(0, -2))
                outputs[kind] = (
                    inputs.new_zeros(*inputs.shape[:-1], OUTPUTS[kind]) if networks is None else networks[kind](inputs)
                )
            after = env.step(self.interface.action(step, outputs))
            joint, total = after.observation, total + after.cost_j.mean()
        return total / env.scenario.horizon, {kind: torch.cat(rows) for kind, rows in seen_by.items()}


class Corrections(torch.nn.ModuleDict):
    """Store one correction network for each kind of agent; the initial outputs are exactly zero."""

    def __init__(self, moments: Mapping[str, tuple[torch.Tensor, torch.Tensor]], hidden: Sequence[int]):
        super().__init__({kind: Perceptron(*moments[kind], OUTPUTS[kind], hidden) for kind in moments})
        for network in self.values():
            torch.nn.init.zeros_(network.layers[-1].weight)  # pyright: ignore

    def policy(self) -> ModelAidedPolicy:
        """Return the current policy as NumPy arrays."""
        networks = {kind: network.exported() for kind, network in self.items()}  # pyright: ignore
        return ModelAidedPolicy(networks, scenario=FAMILY, made_with=made_with())


def tensor(array: np.ndarray) -> torch.Tensor:
    """Convert an array to a tensor, floats to single precision."""
    made = torch.from_numpy(np.array(array))
    return made.float() if made.is_floating_point() else made


def check_settings(cfg: CarryOver) -> None:
    """Raise ValueError with the field's name if a setting is invalid."""
    check(cfg)
    plain = CarryOver()
    for field in ("scenario", "set", "view", "observe", "preview", "act", "device"):
        if getattr(cfg, field) != getattr(plain, field):
            raise ValueError(
                f"{field} is {getattr(cfg, field)!r}; carry-over trains on its own family of random feeders, with "
                f"{field} {getattr(plain, field)!r} alone: leave it out"
            )


def drawn_on(cfg: CarryOver, i: int) -> Scenario:
    """Return training scenario i for the configured seed."""
    return drawn_scenario("train", cfg.seed * _OF_A_SEED + i).replace(horizon=cfg.steps)


def moments(cfg: CarryOver) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
    """Return mean and standard deviation of each network's inputs under the law, over separate scenarios."""
    rows: dict[str, list[torch.Tensor]] = {kind: [] for kind in FEATURES}
    with torch.no_grad():
        for i in range(_OF_A_SEED - _NORMALISED_ON, _OF_A_SEED):
            for kind, inputs in CommissionedEnv(drawn_on(cfg, i)).episodes(None, range(cfg.num_envs))[1].items():
                rows[kind].append(inputs)
    every = {kind: torch.cat(inputs) for kind, inputs in rows.items()}
    return {kind: (inputs.mean(0), inputs.std(0).clamp(min=_LEAST_STD)) for kind, inputs in every.items()}


class HeldOut:
    """Compare networks with the law on the same episodes of held-out scenarios."""

    def __init__(self, cfg: CarryOver):
        self.seeds = range(cfg.validation_episodes)
        self.envs = [CommissionedEnv(drawn_scenario("validation", i)) for i in range(cfg.validation_feeders)]
        self.by_law = self._costs(None)

    def __call__(self, networks: Mapping[str, torch.nn.Module]) -> dict[str, float]:
        """Return mean J of the networks and of the law, and mean and maximum of their ratio over the scenarios."""
        j = self._costs(networks)
        share = j / self.by_law
        return {"J": j.mean(), "J_law": self.by_law.mean(), "share": share.mean(), "worst_share": share.max()}

    def _costs(self, networks: Mapping[str, torch.nn.Module] | None) -> np.ndarray:
        with torch.no_grad():
            return np.array([float(env.episodes(networks, self.seeds)[0]) for env in self.envs])


def main(cfg: CarryOver) -> Path:
    """Train a policy and return the output folder."""
    check_settings(cfg)
    torch.set_num_threads(cfg.threads)
    torch.manual_seed(cfg.seed)
    with open_run(cfg.folder, cfg, cfg.resume) as run:
        networks = Corrections(moments(cfg), cfg.hidden)
        return _train(cfg, run, networks, HeldOut(cfg))


def _train(cfg: CarryOver, run: Run, networks: Corrections, judge: HeldOut) -> Path:
    """Train from the checkpoint of the run, if it has one, and return the output folder."""
    optimiser = torch.optim.Adam(networks.parameters(), lr=cfg.learning_rate)
    averages = torch.optim.swa_utils
    mean = averages.AveragedModel(networks, multi_avg_fn=averages.get_ema_multi_avg_fn(_KEPT))
    best, done, state = math.inf, 0, run.load()
    if state is not None:
        networks.load_state_dict(state["networks"])
        mean.load_state_dict(state["mean"])
        optimiser.load_state_dict(state["optimiser"])
        best, done = state["best"], state["update"]
    with progress(f"{FAMILY}, {cfg.algorithm()}", cfg.updates, done) as advance:
        for update in range(done + 1, cfg.updates + 1):
            run.step, text = update, ""
            optimiser.param_groups[0]["lr"] = (
                0.5 * cfg.learning_rate * (1.0 + math.cos(math.pi * (update - 1) / cfg.updates))
            )
            figures = _update(cfg, run, networks, optimiser, update)
            mean.update_parameters(networks)
            if update % cfg.validate_every == 0 or update == cfg.updates:
                judged: Corrections = mean.module  # pyright: ignore[reportAssignmentType]
                validated = judge(judged)  # pyright: ignore[reportArgumentType] (a mapping in all but name)
                if validated["J"] < best:
                    best = float(validated["J"])  # a number that a checkpoint may contain
                    run.keep(judged.policy(), best)
                run.record(validated | figures | {"env_steps": update * cfg.feeders * cfg.num_envs * cfg.steps})
                text = f"J {validated['J']:.4f}, law {validated['J_law']:.4f}"
            if update % cfg.checkpoint_every == 0 or update == cfg.updates:
                state = {"networks": networks.state_dict(), "mean": mean.state_dict()}
                run.save({**state, "optimiser": optimiser.state_dict(), "best": best, "update": update})
            advance(update, text)
    finish(run)
    print(f"{run.folder}: best on held-out feeders {best:.4f}, the law {judge.by_law.mean():.4f}, {run.seconds:.0f} s")
    return run.folder


def _update(
    cfg: CarryOver, run: Run, networks: Corrections, optimiser: torch.optim.Optimizer, update: int
) -> dict[str, float]:
    """Process one batch, take one optimiser step, and return loss and gradient norm."""
    optimiser.zero_grad()
    losses = []
    for i in range((update - 1) * cfg.feeders, update * cfg.feeders):
        env, seeds = CommissionedEnv(drawn_on(cfg, i)), range(i * cfg.num_envs, (i + 1) * cfg.num_envs)
        loss = torch.log(env.episodes(networks, seeds)[0])  # pyright: ignore[reportArgumentType]
        (loss / cfg.feeders).backward()
        losses.append(float(loss.detach()))
    weights = list(networks.parameters())
    norm = float(torch.nn.utils.clip_grad_norm_(weights, cfg.max_grad_norm))
    run.require_finite("a gradient is", (weight.grad for weight in weights if weight.grad is not None))
    optimiser.step()
    run.require_finite("a weight is", weights)
    return {"loss": float(np.mean(losses)), "gradient_norm": norm}
