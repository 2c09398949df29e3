"""The command ``dcgrid dataset``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env import Scenario, scenario_hash
from dcgrid_env.agents import Policy, evaluate, find_controller
from dcgrid_env.agents.policy.card import Scored
from dcgrid_env.baselines import Controller
from dcgrid_env.baselines.carried import carried
from dcgrid_env.baselines.file_names import file_name
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.offline_data.behaviour import Planned, RandomActions
from dcgrid_env.baselines.offline_data.joint_episodes import JointEpisode, joint_episodes
from dcgrid_env.baselines.registry import tuned_from
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.tuning.tuned import require_tuned
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import Overrides, check_folder
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.versions import meta, versions
from dcgrid_env.core.work.unit import Place, Unit
from dcgrid_env.engine.exogenous.trace_pool import trace_pool

SPLITS = ("train", "validation")
"""Splits that data may come from; the other splits are reserved for evaluation."""
RANDOM, HINDSIGHT, DROOP = "random", "hindsight", "droop-tuned"


@dataclass(frozen=True)
class Dataset(OverWorkers):
    """Write episodes as a Minari data set for offline learning.

    Requires the minari extra. An interrupted command leaves no partial data set.
    """

    scenario: str = "ieee33-weak"
    """Scenario: a name (dcgrid list), path/to/file.toml, path/to/file.py:function or package.module:function."""
    set: Overrides = ()
    """Scenario fields to override, for example --set horizon=60 sensing.noise_pu=0.005."""
    controller: str = DROOP
    """Controller of the episodes: a controller or policy (dcgrid list), your class (file.py:Class), a training run's
    folder, a policy file (.safetensors), random (uniform actions) or hindsight (the perfect-foresight plan of each
    episode). Several, separated by commas, control the episodes in turn."""
    noise: float = 0.0
    """Standard deviation of Gaussian noise on the actions, which range from -1 to 1. For example, 0.2 adds actions that
    the controller would not choose. Random actions have no noise."""
    episodes: int = 100
    """Number of episodes, with seeds SEED, SEED + 1, ..."""
    seed: int = 0
    """Seed of the first episode."""
    behaviour_seed: int = 0
    """Seed of the noise and of the random actions, independent of the episodes."""
    split: str = "train"
    """Split of the episodes: train or validation. The test and ood splits are reserved for evaluation."""
    tuned: Path | None = None
    """File with the gains of the tuned controllers, written by dcgrid tune. Default: results/tuned.json if it has gains
    for this exact scenario, otherwise the gains bundled with the preset."""
    name: str | None = None
    """Name of the data set, whose id is dcgrid/SCENARIO/NAME-v0. Default: built from controller, noise and split."""
    out: Path | None = None
    """Root folder of Minari data sets. Default: $MINARI_DATASETS_PATH if set, otherwise results/datasets."""

    @property
    def controllers(self) -> tuple[str, ...]:
        """Names of the controllers, in the order of their episodes."""
        return tuple(self.controller.split(","))

    def run(self) -> None:
        """Run and write; raise ValueError before writing if a setting is invalid."""
        from dcgrid_env.baselines.offline_data.minari_writer import CARD, dataset_id, default_root, new_dataset

        _check(self)
        place, spec = self.place, ScenarioSpec(self.scenario, self.set)
        scenario = spec.make(self.split)
        name = dataset_id(scenario, _name(self) if self.name is None else self.name)
        root = default_root() if self.out is None else self.out
        check_folder(root)
        console = plain_console()
        with new_dataset(root, name, scenario, _behaviour(self)) as writer, progress_bar(console) as progress:
            bar = progress.add_task("episodes", total=self.episodes)
            costs: list[float] = []
            for episodes in _episodes(self, spec, scenario, place):
                writer.add(episodes)
                costs += [episode.J for episode in episodes]
                progress.advance(bar, len(episodes))
            card = _card(self, scenario, name, costs)
            writer.describe(card)
        mean, droop = f"mean J {card['J']['mean']:.4f}", card["J_droop_tuned"]
        beside = "" if droop is None else f" (tuned droop on the same episodes: {droop:.4f})"
        say(console, f"{name}: {self.episodes} episodes of the {self.split} split, {mean}{beside}")
        for line in tuned_from(self.controllers, scenario, self.tuned):
            console.print(line)
        say(console, f"wrote {root / name}, with its card {CARD}")
        say(console, f"to load it: set MINARI_DATASETS_PATH={root.absolute()}, then call minari.load_dataset({name!r})")


def _check(cfg: Dataset) -> None:
    """Raise ValueError if a setting is invalid."""
    from dcgrid_env.baselines.offline_data.minari_writer import require_minari

    if cfg.split not in SPLITS:
        raise ValueError(
            f"split: must be {' or '.join(SPLITS)}, got {cfg.split!r}; the other splits are reserved for evaluation"
        )
    if set(cfg.controllers) == {RANDOM} and cfg.noise:
        raise ValueError(f"noise: must be 0 with random actions, got {cfg.noise}; remove --noise")
    if "" in cfg.controllers:
        raise ValueError(f"controller: a name is empty in {cfg.controller!r}; remove the comma, or name a controller")
    if len(set(cfg.controllers)) < len(cfg.controllers):
        raise ValueError(f"controller: {cfg.controller!r} has a name twice; name each one once")
    if cfg.episodes < len(cfg.controllers):
        raise ValueError(
            f"episodes: must be at least the number of controllers, {len(cfg.controllers)}, got {cfg.episodes}; "
            "raise --episodes or name fewer controllers"
        )
    require_tuned(cfg.tuned)
    require_minari()


def _name(cfg: Dataset) -> str:
    """Return the default name of the data set, unique within its scenario."""
    noise = f"-noise-{cfg.noise:g}".replace(".", "_") if cfg.noise else ""
    return "-and-".join(map(file_name, cfg.controllers)) + noise + ("" if cfg.split == SPLITS[0] else f"-{cfg.split}")


def _behaviour(cfg: Dataset) -> str:
    return cfg.controller + (f" with noise of {cfg.noise:g}" if cfg.noise else "")


def _episodes(cfg: Dataset, spec: ScenarioSpec, scenario: Scenario, place: Place) -> Iterator[list[JointEpisode]]:
    """Run the episodes in batches, each episode under the controller whose turn it is."""
    from dcgrid_env.baselines.offline_data.minari_writer import batches

    names = cfg.controllers
    for seeds in batches(range(cfg.seed, cfg.seed + cfg.episodes), scenario.horizon):
        found: dict[int, JointEpisode] = {}
        for turn, name in enumerate(names):
            if members := [seed for seed in seeds if (seed - cfg.seed) % len(names) == turn]:
                controller = _controller(cfg, name, spec, scenario, members, place)
                noise = 0.0 if name == RANDOM else cfg.noise
                chosen: dict[str, Any] = {"noise": noise, "behaviour_seed": cfg.behaviour_seed, "name": name}
                found |= zip(members, joint_episodes(scenario, controller, members, **chosen), strict=True)
        yield [found[seed] for seed in seeds]


def _controller(
    cfg: Dataset, name: str, spec: ScenarioSpec, scenario: Scenario, seeds: Sequence[int], place: Place
) -> Controller:
    """Return the controller of this name for the episodes of these seeds."""
    if name == RANDOM:
        return RandomActions(seeds, cfg.behaviour_seed)
    if name != HINDSIGHT:
        return find_controller(name, scenario, cfg.tuned)
    plans: dict[int, np.ndarray] = {}
    units = [Unit(f"plan of seed {seed}", partial(_planned, spec, cfg.split), seed) for seed in seeds]
    for unit, plan in place.results(units, carried(place, [spec.where]), how_to_go_on=""):
        plans[unit.item] = plan
    return Planned(np.stack([plans[seed] for seed in seeds]))


def _planned(spec: ScenarioSpec, split: str, seed: int) -> np.ndarray:
    """Return the perfect-foresight actions in the episode of a seed, (T, n_action)."""
    return hindsight(spec.make(split), seed).actions


def _card(cfg: Dataset, scenario: Scenario, name: str, costs: Sequence[float]) -> dict[str, Any]:
    """Return the contents of card.json."""
    return {
        "format": 1,
        "id": name,
        "licence": "MIT",
        "scenario": scenario.name,
        "scenario_hash": scenario_hash(scenario),
        "split": cfg.split,
        "seeds": {"first": cfg.seed, "episodes": cfg.episodes},
        "steps": cfg.episodes * scenario.horizon,
        "controller": cfg.controller,
        "noise": cfg.noise,
        "behaviour_seed": cfg.behaviour_seed,
        "J": {"mean": sum(costs) / len(costs), "least": min(costs), "most": max(costs)},
        "J_droop_tuned": _droop(cfg, scenario),
        **_score(cfg, scenario),
        "traces": _traces(scenario),
        **meta(),
        "minari": versions(("minari", "h5py")),
    }


def _droop(cfg: Dataset, scenario: Scenario) -> float | None:
    """Return the mean J of the tuned droop on the same episodes; None if it has no gains for the scenario."""
    try:
        droop = find_controller(DROOP, scenario, cfg.tuned)
    except ValueError:
        return None
    return evaluate(droop, scenario, range(cfg.seed, cfg.seed + cfg.episodes)).means["J"]


def _score(cfg: Dataset, scenario: Scenario) -> dict[str, Any]:
    """Return the test score of the controller if it is known: by definition, or from a policy's card."""
    known = {DROOP: 0.0, HINDSIGHT: 1.0}.get(cfg.controller)
    if cfg.noise:
        return {"score": None, "score_why": "with noise it was scored nowhere"}
    if known is not None:
        return {"score": known, "score_why": "by definition"}
    scored = None if len(cfg.controllers) > 1 or cfg.controller == RANDOM else _scored(cfg, scenario)
    if scored is None:
        return {"score": None, "score_why": "no card says it"}
    return {
        "score": scored.score[0],
        "score_why": f"the policy's card, {scored.episodes} episodes, {scored.split} split",
    }


def _scored(cfg: Dataset, scenario: Scenario) -> Scored | None:
    """Return the score on the scenario from a policy's card; None if there is none."""
    policy = find_controller(cfg.controller, scenario, cfg.tuned)
    if not isinstance(policy, Policy):
        return None
    scored = None if policy.card is None else policy.card.scored
    if scored is None:
        return None
    return scored if scored.scenario_hash == scenario_hash(scenario.replace(split=scored.split)) else None


def _traces(scenario: Scenario) -> list[dict[str, Any]]:
    """Return the sources of the data centres' load without duplicates: generator, or licence and citation."""
    found: list[dict[str, Any]] = []
    for provenance in trace_pool(scenario).provenance:
        record = {key: value for key, value in provenance.record().items() if key != "seed"}
        if record not in found:
            found.append(record)
    return found
