"""A policy that carries over: corrections of the model-aided law, learned on random feeders.

Each scenario of a batch is another one of ``training.drawn_feeders``: another feeder, other places, numbers and ratings
of devices, another substation voltage, other work. Its agents are commissioned as the law's are
(``baselines.model_aided``), the networks correct the law (``policy.law_interface``), at first by nothing, and the cost
of whole episodes is followed down its gradient, which goes through the grid and through the law (``policy.law_step``):

    loss = mean over the batch's scenarios of the logarithm of J

The logarithm lets a feeder that is hard count no more than one that is easy. Batches of a few feeders differ much from
each other, so that policies are judged, and kept, with the mean of the latest weights, and not with those of one
update: B. T. Polyak and A. B. Juditsky, SIAM J. Control Optim. 30(4), 1992. What is kept is the policy with the least
mean J on held-out scenarios of the same family. No named feeder is ever seen.
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
from dcgrid_env.agents.training.config import Training, check
from dcgrid_env.agents.training.drawn_feeders import FAMILY, drawn_scenario
from dcgrid_env.agents.training.run_folder import Run, finish, open_run, progress, torch
from dcgrid_env.agents.training.torch_modules import Perceptron, forgiving_clip
from dcgrid_env.agents.training.validation import made_with
from dcgrid_env.baselines.model_aided.commissioning import commission, site_of

_NORMALISED_ON = 16
"""Scenarios on which the figures are normalised, the last ones of a training seed, which training never comes to."""
_OF_A_SEED = 1 << 24
"""Scenarios of one training seed."""
_LEAST_STD = 2e-2
_KEPT = 0.97
"""Share of the mean of the weights that an update leaves."""


@dataclass(frozen=True)
class CarryOver(Training):
    """Train a policy for feeders that it never saw."""

    scenario: str = FAMILY
    """The family of scenarios on random feeders; there is no other."""
    updates: int = 300
    """Steps of the optimiser."""
    feeders: int = 6
    """Scenarios of a batch, each on a feeder of its own."""
    num_envs: int = 8
    """Episodes on each."""
    steps: int = 60
    """Steps of an episode in training, all in one window; it is judged on episodes of 120."""
    learning_rate: float = 3e-3
    """At the beginning; it falls to nothing along a cosine."""
    max_grad_norm: float = 0.3
    """Gradients are cut to this norm."""
    hidden: tuple[int, ...] = (48, 48)
    """Widths of the hidden layers."""
    validation_feeders: int = 16
    """Held-out scenarios that a policy is judged on."""
    validation_episodes: int = 4
    """Episodes of each."""
    validate_every: int = 25
    """Updates from one validation to the next."""
    checkpoint_every: int = 25
    """Updates from one checkpoint to the next."""

    @property
    def subject(self) -> str:
        """The family, which is no scenario that has a name of its own."""
        return FAMILY

    @classmethod
    def algorithm(cls) -> str:
        """Name of the algorithm on the command line."""
        return "carry-over"


class CommissionedEnv:
    """Differentiable episodes of a scenario with fixed places, whose agents are commissioned.

    ValueError where the law cannot drive it.
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
        """Mean J of the episodes of these seeds, the law's alone without networks, and all that networks saw."""
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
    """The networks, one for each kind of agent; at the beginning all they give is exactly 0."""

    def __init__(self, moments: Mapping[str, tuple[torch.Tensor, torch.Tensor]], hidden: Sequence[int]):
        super().__init__({kind: Perceptron(*moments[kind], OUTPUTS[kind], hidden) for kind in moments})
        for network in self.values():
            torch.nn.init.zeros_(network.layers[-1].weight)  # pyright: ignore

    def policy(self) -> ModelAidedPolicy:
        """The policy as it stands, as NumPy arrays."""
        networks = {kind: network.exported() for kind, network in self.items()}  # pyright: ignore
        return ModelAidedPolicy(networks, scenario=FAMILY, made_with=made_with())


def tensor(array: np.ndarray) -> torch.Tensor:
    """An array as a tensor, floats in single precision."""
    made = torch.from_numpy(np.array(array))
    return made.float() if made.is_floating_point() else made


def check_settings(cfg: CarryOver) -> None:
    """Raise ValueError, naming the field, if a setting is invalid."""
    check(cfg)
    plain = CarryOver()
    for field in ("scenario", "set", "view", "observe", "preview", "act", "device"):
        if getattr(cfg, field) != getattr(plain, field):
            raise ValueError(
                f"{field} is {getattr(cfg, field)!r}; carry-over trains on its own family of random feeders, with "
                f"{field} {getattr(plain, field)!r} alone: leave it out"
            )


def drawn_on(cfg: CarryOver, i: int) -> Scenario:
    """Training scenario i of a configuration's seed."""
    return drawn_scenario("train", cfg.seed * _OF_A_SEED + i).replace(horizon=cfg.steps)


def moments(cfg: CarryOver) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
    """Mean and standard deviation of what each network sees under the law, over scenarios of their own."""
    rows: dict[str, list[torch.Tensor]] = {kind: [] for kind in FEATURES}
    with torch.no_grad():
        for i in range(_OF_A_SEED - _NORMALISED_ON, _OF_A_SEED):
            for kind, inputs in CommissionedEnv(drawn_on(cfg, i)).episodes(None, range(cfg.num_envs))[1].items():
                rows[kind].append(inputs)
    every = {kind: torch.cat(inputs) for kind, inputs in rows.items()}
    return {kind: (inputs.mean(0), inputs.std(0).clamp(min=_LEAST_STD)) for kind, inputs in every.items()}


class HeldOut:
    """Judges networks on held-out scenarios of the family, against the law on the same episodes."""

    def __init__(self, cfg: CarryOver):
        self.seeds = range(cfg.validation_episodes)
        self.envs = [CommissionedEnv(drawn_scenario("validation", i)) for i in range(cfg.validation_feeders)]
        self.by_law = self._costs(None)

    def __call__(self, networks: Mapping[str, torch.nn.Module]) -> dict[str, float]:
        """Mean J, the law's, and the mean and largest quotient of both over the scenarios."""
        j = self._costs(networks)
        share = j / self.by_law
        return {"J": j.mean(), "J_law": self.by_law.mean(), "share": share.mean(), "worst_share": share.max()}

    def _costs(self, networks: Mapping[str, torch.nn.Module] | None) -> np.ndarray:
        with torch.no_grad():
            return np.array([float(env.episodes(networks, self.seeds)[0]) for env in self.envs])


def main(cfg: CarryOver) -> Path:
    """Train; the folder written."""
    check_settings(cfg)
    torch.set_num_threads(cfg.threads)
    torch.manual_seed(cfg.seed)
    with open_run(cfg.folder, cfg, cfg.resume) as run:
        networks = Corrections(moments(cfg), cfg.hidden)
        return _train(cfg, run, networks, HeldOut(cfg))


def _train(cfg: CarryOver, run: Run, networks: Corrections, judge: HeldOut) -> Path:
    """Train from the run's checkpoint on; the folder written."""
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
                    best = validated["J"]
                    card = {"seed": cfg.seed, "training_s": run.seconds, "validation_J": best}
                    judged.policy().save(run.folder / "policy.safetensors", card | {"algorithm": cfg.algorithm()})
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
    """One batch and one step of the optimiser; what it came to."""
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
