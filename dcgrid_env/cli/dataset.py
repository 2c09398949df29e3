"""The command ``dcgrid dataset``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.settings import Overrides, at_least, check_folder, tuned_from
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.cli.workers import OverWorkers
from dcgrid_env.core.versions import meta, versions

if TYPE_CHECKING:
    import numpy as np

    from dcgrid_env import Scenario
    from dcgrid_env.agents.policy.card import Scored
    from dcgrid_env.baselines import Controller
    from dcgrid_env.baselines.offline_data.joint_episodes import JointEpisode
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec
    from dcgrid_env.core.work.unit import Place

SPLITS = ("train", "validation")
"""Splits that data may come from; what is learned from episodes of the others could not be judged on them."""
RANDOM, HINDSIGHT, DROOP = "random", "hindsight", "droop-tuned"


@dataclass(frozen=True)
class Dataset(OverWorkers):
    """Write episodes as a Minari data set for offline learning.

    Takes the extra minari.

    The data set is there whole once the command has ended, or not at all.
    """

    scenario: str = "ieee33-weak"
    """Name of a scenario (dcgrid list), path/to/file.toml, or path/to/file.py:function or package.module:function that
    makes your own."""
    set: Overrides = ()
    """Fields of the scenario that are to be otherwise, for instance --set horizon=60 sensing.noise_pu=0.005."""
    controller: str = DROOP
    """What acts: a controller or policy (dcgrid list), a class of your own (file.py:Class), a training run's folder or
    a policy's file (.safetensors), random for actions drawn evenly, or hindsight for the plan of perfect foresight of
    each episode."""
    noise: float = 0.0
    """Standard deviation of normal noise on each entry of an action, which reaches from -1 to 1; 0.2 shows a learner
    what other actions than the controller's come to."""
    episodes: int = 100
    """Number of episodes: those of seeds seed, seed + 1, ..."""
    seed: int = 0
    """Seed of the first episode."""
    behaviour_seed: int = 0
    """Another one draws other noise, or other random actions, in the same episodes."""
    split: str = "train"
    """Which episodes the seeds mean: train or validation. The test and ood splits are kept for judging."""
    tuned: Path | None = None
    """File of dcgrid tune that the gains of tuned controllers must come from. Without it they are those of
    results/tuned.json where they were found for this very scenario, else those that ship with the preset."""
    name: str | None = None
    """Name of the data set; by default made of controller, noise and split. Its id is dcgrid/SCENARIO/NAME-v0."""
    out: Path | None = None
    """Folder of all data sets, in Minari's layout; $MINARI_DATASETS_PATH where that is set, else results/datasets."""

    def run(self) -> None:
        """Run and write. ValueError for an invalid setting, before anything is written."""
        from dcgrid_env.baselines.offline_data.minari_writer import CARD, dataset_id, default_root, new_dataset
        from dcgrid_env.baselines.scenario_spec import ScenarioSpec

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
        beside = "" if droop is None else f", the tuned droop's on the same {droop:.4f}"
        say(console, f"{name}: {self.episodes} episodes of the {self.split} split, {mean}{beside}")
        for line in tuned_from([self.controller], scenario, self.tuned):
            console.print(line)
        say(console, f"wrote {root / name}, its card is {CARD}")
        say(console, f"MINARI_DATASETS_PATH={root.absolute()} lets minari.load_dataset({name!r}) find it")


def _check(cfg: Dataset) -> None:
    """ValueError for an invalid setting."""
    from dcgrid_env.baselines.offline_data.minari_writer import require_minari
    from dcgrid_env.baselines.tuning.tuned import require_tuned

    at_least(cfg, episodes=1, seed=0, noise=0, behaviour_seed=0)
    if cfg.split not in SPLITS:
        raise ValueError(
            f"split is {cfg.split!r}; choose {' or '.join(SPLITS)}: what is learned from episodes of another split "
            "cannot be judged on it"
        )
    if not cfg.noise <= 2.0:
        raise ValueError(f"noise is {cfg.noise}; give at most 2, which is the whole range of an action")
    if cfg.controller == RANDOM and cfg.noise:
        raise ValueError(f"noise is {cfg.noise}, and random actions are noise already; leave it out")
    require_tuned(cfg.tuned)
    require_minari()


def _name(cfg: Dataset) -> str:
    """What tells the data set from others of its scenario."""
    from dcgrid_env.baselines.file_names import file_name

    noise = f"-noise-{cfg.noise:g}".replace(".", "_") if cfg.noise else ""
    return file_name(cfg.controller) + noise + ("" if cfg.split == SPLITS[0] else f"-{cfg.split}")


def _behaviour(cfg: Dataset) -> str:
    return cfg.controller + (f" with noise of {cfg.noise:g}" if cfg.noise else "")


def _episodes(cfg: Dataset, spec: ScenarioSpec, scenario: Scenario, place: Place) -> Iterator[list[JointEpisode]]:
    """Run the episodes, batch by batch."""
    from dcgrid_env.baselines.offline_data.joint_episodes import joint_episodes
    from dcgrid_env.baselines.offline_data.minari_writer import batches

    chosen: dict[str, Any] = {"noise": cfg.noise, "behaviour_seed": cfg.behaviour_seed, "name": cfg.controller}
    for seeds in batches(range(cfg.seed, cfg.seed + cfg.episodes), scenario.horizon):
        yield joint_episodes(scenario, _controller(cfg, spec, scenario, seeds, place), seeds, **chosen)


def _controller(cfg: Dataset, spec: ScenarioSpec, scenario: Scenario, seeds: Sequence[int], place: Place) -> Controller:
    """What acts in the episodes of these seeds."""
    import numpy as np

    from dcgrid_env.agents import find_controller
    from dcgrid_env.baselines.carried import carried
    from dcgrid_env.baselines.offline_data.behaviour import Planned, RandomActions
    from dcgrid_env.core.work.unit import Unit

    if cfg.controller == RANDOM:
        return RandomActions(seeds, cfg.behaviour_seed)
    if cfg.controller != HINDSIGHT:
        return find_controller(cfg.controller, scenario, cfg.tuned)
    plans: dict[int, np.ndarray] = {}
    units = [Unit(f"plan of seed {seed}", partial(_planned, spec, cfg.split), seed) for seed in seeds]
    for unit, plan in place.results(units, carried(place, [spec.where]), how_to_go_on=""):
        plans[unit.item] = plan
    return Planned(np.stack([plans[seed] for seed in seeds]))


def _planned(spec: ScenarioSpec, split: str, seed: int) -> np.ndarray:
    """Actions of perfect foresight in the episode of a seed, (T, n_action)."""
    from dcgrid_env.baselines.model_based.hindsight import hindsight

    return hindsight(spec.make(split), seed).actions


def _card(cfg: Dataset, scenario: Scenario, name: str, costs: Sequence[float]) -> dict[str, Any]:
    """What stands in card.json."""
    from dcgrid_env import scenario_hash

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
    """Mean J of the tuned droop on the same episodes; None where no gains of it are known for the scenario."""
    from dcgrid_env.agents import evaluate, find_controller

    try:
        droop = find_controller(DROOP, scenario, cfg.tuned)
    except ValueError:
        return None
    return evaluate(droop, scenario, range(cfg.seed, cfg.seed + cfg.episodes)).means["J"]


def _score(cfg: Dataset, scenario: Scenario) -> dict[str, Any]:
    """Score of the behaviour on the test split where it is known: by definition, or from a policy's card."""
    known = {DROOP: 0.0, HINDSIGHT: 1.0}.get(cfg.controller)
    if cfg.noise:
        return {"score": None, "score_why": "with noise it was scored nowhere"}
    if known is not None:
        return {"score": known, "score_why": "by definition"}
    scored = None if cfg.controller == RANDOM else _scored(cfg, scenario)
    if scored is None:
        return {"score": None, "score_why": "no card says it"}
    return {
        "score": scored.score[0],
        "score_why": f"the policy's card, {scored.episodes} episodes, {scored.split} split",
    }


def _scored(cfg: Dataset, scenario: Scenario) -> Scored | None:
    """What a policy's card says of its score on the scenario."""
    from dcgrid_env import scenario_hash
    from dcgrid_env.agents import Policy, find_controller

    policy = find_controller(cfg.controller, scenario, cfg.tuned)
    if not isinstance(policy, Policy):
        return None
    scored = None if policy.card is None else policy.card.scored
    if scored is None:
        return None
    return scored if scored.scenario_hash == scenario_hash(scenario.replace(split=scored.split)) else None


def _traces(scenario: Scenario) -> list[dict[str, Any]]:
    """Where the data centres' load comes from, each once whatever its seeds: generator, or licence and citation."""
    from dcgrid_env.engine.exogenous.trace_pool import trace_pool

    found: list[dict[str, Any]] = []
    for provenance in trace_pool(scenario).provenance:
        record = {key: value for key, value in provenance.record().items() if key != "seed"}
        if record not in found:
            found.append(record)
    return found
