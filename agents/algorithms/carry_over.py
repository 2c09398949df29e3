"""Train corrections of the model-aided law on random feeders, for use on new feeders.

Each scenario of a batch has a different feeder (``random_feeder``). The number, location and size of data centres and
inverters, the substation voltage, the load fluctuation and the work are also random. Ratings are relative to the
feeder's load, so small feeders have small devices. A split and a number identify a scenario, and splits have no
scenario in common. Agents are commissioned as for the law (``baselines.model_aided``). The networks
correct the law (``policy.law_interface``); their initial corrections are zero. The gradient of the cost of complete
episodes passes through the grid and the law (:class:`LawGradient`):

    loss = mean over the batch's scenarios of log(J)

The logarithm gives difficult and easy feeders the same weight. Small batches of feeders differ much from each other.
Therefore a moving average of the weights is validated and saved, not the weights of one update. The saved policy has
the smallest mean J on held-out scenarios of the same family. Training uses none of the presets' feeders.

Reference: B. T. Polyak and A. B. Juditsky, SIAM J. Control Optim. 30(4), 1992.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import Feeder, FeederError, Scenario, TensorEnv, make_scenario, random_feeder
from dcgrid_env.agents.policy.law_interface import FEATURES, OUTPUTS, LawInterface
from dcgrid_env.agents.policy.model_aided_policy import ModelAidedPolicy
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.training.config import NetworkTraining, check
from dcgrid_env.agents.training.run_folder import Run, open_run, torch
from dcgrid_env.agents.training.torch_modules import Perceptron, cosine, forgiving_clip
from dcgrid_env.agents.training.training_loop import train
from dcgrid_env.agents.training.validation import made_with
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of
from dcgrid_env.baselines.model_aided.expected_cost import VoltagePrice
from dcgrid_env.baselines.model_aided.law_step import Decided, LawStep, Past

FAMILY = "drawn-feeders"
"""Training scenario in the files of policies that were trained on the family."""
_SALT = {"train": 1, "validation": 2}
_STYLES = {"us-mv": 0.7, "rural": 0.25, "urban": 0.05}
_TRACES = {"inference": 0.55, "code": 0.2, "mixed": 0.25}
_LARGEST_FEEDERS = 1 << 32
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


class LawGradient(LawStep):
    """A second of the law with its derivative, for tensors.

    Both decisions are zeros of rising functions F(t, x) = 0, so by the implicit function

        dt/dx = -(dF/dx) / (dF/dt)

    where no limit stops t, and 0 where one does. So a policy is trained through the law on what it acts on.
    """

    def _cut(self, v: Any, inverse: Any, found: Decided) -> Any:
        cut_kw = super()._cut(v, inverse, found)
        if not v.requires_grad:
            return cut_kw
        inside = self._like((found.best.cut_kw > 0.0) & (found.best.cut_kw < found.seen.span_kw))
        by_p, by_draw = (by[:, : self._n_dc] for by in (self.known.by_p, self.known.by_draw))
        slope, curve = self._slopes(v + by_draw * cut_kw[..., None], inverse)
        return _implicit(cut_kw, (slope * by_p).sum(-1), (curve * by_p * by_draw).sum(-1), inside)

    def _respond(self, v: Any, inverse: Any, by_all: Any, share: Any, rest: Any, found: Decided) -> Any:
        chosen = super()._respond(v, inverse, by_all, share, rest, found)
        if not v.requires_grad:
            return chosen
        limit = self._like(self.site.limit_kvar(found.seen.p_kw)) / self._scale
        slope, curve = self._slopes(v + (chosen - share)[..., None] * by_all, inverse)
        rise = (slope * self.by_q).sum(-1) + self.known.hold * (chosen - rest)
        steep = (curve * self.by_q * by_all).sum(-1) + self.known.hold
        return _implicit(chosen, rise, steep, (abs(chosen) < 0.999 * limit) & (abs(chosen) > 0.0))

    def _slopes(self, v: torch.Tensor, inverse: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Slope of the expected cost by each expected voltage, and its slope; see ``VoltagePrice``."""
        price = VoltagePrice.from_scenario(self.scenario)
        x, b, phi = (v - 1.0) * inverse, price.band_pu * inverse, torch.special.ndtr
        slope = price.voltage * (2.0 * phi(x) - 1.0) + price.violation * (phi(x - b) - phi(-x - b))
        density = [torch.exp(-0.5 * z.detach() ** 2) / (2.0 * np.pi) ** 0.5 for z in (x, x - b, x + b)]
        return slope, (2.0 * price.voltage * density[0] + price.violation * (density[1] + density[2])) * inverse


def _implicit(found: torch.Tensor, function: torch.Tensor, steep: torch.Tensor, inside: torch.Tensor) -> torch.Tensor:
    """``found`` with the derivative of the implicit function where ``inside``, else none."""
    moved = (function - function.detach()) / steep.detach().clip(1e-9, None)
    return found - torch.where(inside, moved, 0.0 * moved)


class CommissionedEnv:
    """Simulate differentiable episodes of a scenario with fixed placements and commissioned agents.

    Raises ValueError if the law cannot control the scenario.
    """

    def __init__(self, scenario: Scenario):
        site, s = site_of(scenario), scenario
        buses = [s.feeder.index(bus) for device in s.devices for bus in device.buses or ()]
        known = commission(site, np.array([buses]))
        self.interface = LawInterface(site, known, array=tensor, clip=forgiving_clip, tops=False, law=LawGradient)
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


def drawn_scenario(split: str, i: int) -> Scenario:
    """Return scenario i of a split, ``train`` or ``validation``, with the traces and episodes of that split."""
    rng = np.random.default_rng([16, _SALT[split], i])
    n_bus = round(float(np.exp(rng.uniform(np.log(16), np.log(130)))))
    load_kw = float(np.exp(rng.uniform(np.log(1500.0), np.log(9000.0))))
    style = str(rng.choice(list(_STYLES), p=list(_STYLES.values())))
    feeder, load_kw = _feeder(load_kw, int(rng.integers(_LARGEST_FEEDERS)), n_bus, style)
    n_dc, n_inv = int(rng.integers(1, 7)), int(rng.integers(2, 9))
    buses = rng.choice(_loaded(feeder), n_dc + n_inv, replace=False)
    sun = rng.random() < 0.2
    sites_kw = load_kw * rng.uniform(0.3, 1.2) * _parts(rng, n_dc)
    kva = load_kw * np.exp(rng.uniform(np.log(0.1), np.log(1.0))) * (2.5 if sun else 1.0) * _parts(rng, n_inv)
    return make_scenario("ieee33").replace(
        name=f"drawn-{split}-{i}",
        feeder=feeder,
        source_voltage_pu=float(rng.uniform(1.0, 1.05)),
        n_datacenters=n_dc,
        datacenters={
            "buses": tuple(feeder.bus_ids[bus] for bus in buses[:n_dc]),
            "p_rated_kw": tuple(sites_kw),
            "s_rated_share": float(rng.uniform(1.02, 1.1)),
        },
        inverters={
            "buses": tuple(feeder.bus_ids[bus] for bus in buses[n_dc:]),
            "s_rated_kva": tuple(kva),
            "injection": "pv" if sun else None,
        },
        trace=str(rng.choice(list(_TRACES), p=list(_TRACES.values()))),
        workload={"site_correlation": float(rng.random() < 0.15)},
        background={"load_sigma": float(rng.uniform(0.02, 0.08))},
        split=split,
    )


def _feeder(load_kw: float, seed: int, n_bus: int, style: str) -> tuple[Feeder, float]:
    """Draw a feeder of a load, or of the style's own load if it has no such feeder on so many buses; and the load."""
    try:
        return random_feeder(seed, n_bus=n_bus, style=style, load_kw=load_kw), load_kw
    except FeederError:
        feeder = random_feeder(seed, n_bus=n_bus, style=style)
        return feeder, float(np.sum(feeder.p_load_kw))


def _loaded(feeder: Feeder) -> np.ndarray:
    """Return the positions of buses with a load, at least as many as devices may be placed at."""
    load_kw = np.asarray(feeder.p_load_kw)
    buses = np.flatnonzero(load_kw > 0)
    buses = buses[buses > 0]
    return buses if len(buses) >= 14 else np.arange(1, len(load_kw))


def _parts(rng: np.random.Generator, n: int) -> np.ndarray:
    """Shares of n devices, which add up to 1, none above three times another."""
    weights = np.exp(rng.uniform(0.0, np.log(3.0), n))
    return weights / weights.sum()


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
        learner, held_out = Learner(cfg), HeldOut(cfg)
        law = ("law", float(held_out.by_law.mean()))
        return train(run, learner, cfg.updates, lambda _: held_out(learner.average), law)


class Learner:
    """Store networks, their moving average and the optimiser, and train on batches of feeders."""

    def __init__(self, cfg: CarryOver):
        self.cfg, self.networks = cfg, Corrections(moments(cfg), cfg.hidden)
        self.optimiser = torch.optim.Adam(self.networks.parameters(), lr=cfg.learning_rate)
        averages = torch.optim.swa_utils
        self.mean = averages.AveragedModel(self.networks, multi_avg_fn=averages.get_ema_multi_avg_fn(_KEPT))

    def iterate(self, iteration: int, run: Run) -> dict[str, float]:
        """Process one batch, take one optimiser step, and return figures for the learning curve."""
        cfg, networks = self.cfg, self.networks
        self.optimiser.param_groups[0]["lr"] = cosine(cfg.learning_rate, iteration, cfg.updates)
        self.optimiser.zero_grad()
        losses = []
        for i in range((iteration - 1) * cfg.feeders, iteration * cfg.feeders):
            env, seeds = CommissionedEnv(drawn_on(cfg, i)), range(i * cfg.num_envs, (i + 1) * cfg.num_envs)
            loss = torch.log(env.episodes(networks, seeds)[0])  # pyright: ignore[reportArgumentType]
            (loss / cfg.feeders).backward()
            losses.append(float(loss.detach()))
        weights = list(networks.parameters())
        norm = float(torch.nn.utils.clip_grad_norm_(weights, cfg.max_grad_norm))
        run.require_finite("a gradient is", (weight.grad for weight in weights if weight.grad is not None))
        self.optimiser.step()
        run.require_finite("a weight is", weights)
        self.mean.update_parameters(networks)
        env_steps = float(iteration * cfg.feeders * cfg.num_envs * cfg.steps)
        return {"loss": float(np.mean(losses)), "gradient_norm": norm, "env_steps": env_steps}

    @property
    def average(self) -> Any:
        """Networks with the averaged weights."""
        return self.mean.module

    def policy(self) -> Policy:
        """Return the policy of the average."""
        return self.average.policy()

    def state(self) -> dict[str, Any]:
        """Return the state from which training can continue."""
        parts = {"networks": self.networks, "mean": self.mean, "optimiser": self.optimiser}
        return {name: part.state_dict() for name, part in parts.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a state that ``state()`` returned."""
        self.networks.load_state_dict(state["networks"])
        self.mean.load_state_dict(state["mean"])
        self.optimiser.load_state_dict(state["optimiser"])
