"""The command ``dcgrid hindsight``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcgrid_env.baselines.scenario_names import scenario_specs
from dcgrid_env.core.commands.command import GOES_ON
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import Overrides, Scenarios, alone_in
from dcgrid_env.core.commands.terminal import plain_console
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.files import write_json
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from rich.console import Console

    from dcgrid_env import Scenario
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec
    from dcgrid_env.core.work.unit import Place


@dataclass(frozen=True)
class Hindsight(OverWorkers):
    """Solve episodes with perfect foresight and store the costs.

    Writes one JSON file for each scenario, which dcgrid evaluate and benchmark use for scores.

    The file is written after each episode. Run an interrupted command again to resume. Each file contains the command
    that reproduces it: all seeds from 0 to the largest one. If an interruption left out seeds, that command adds them.
    """

    scenarios: Scenarios = "all"
    """Scenarios, separated by commas: names (dcgrid list), path/to/file.toml, path/to/file.py:function or
    package.module:function; or all for every preset."""
    set: Overrides = ()
    """Fields to override in every scenario, for example --set horizon=60 sensing.noise_pu=0.005."""
    episodes: int = 100
    """Number of episodes for each scenario, with seeds 0, 1, ..."""
    split: str = "test"
    """Split of the episodes: train, validation or test."""
    out: Path = Path("results/hindsight")
    """Folder for SCENARIO.json. Episodes that the file already contains are not solved again."""

    @property
    def resumes(self) -> str:
        """Message on how to resume; finished work is kept."""
        return GOES_ON

    def run(self) -> None:
        """Solve missing episodes; raise ValueError if a setting is invalid or a file is damaged or does not match."""
        place = self.place
        specs = scenario_specs(self.scenarios, self.set, self.split)
        console = plain_console()
        kept = solve_missing(specs, self.split, dict.fromkeys(specs, range(self.episodes)), self.out, place, console)
        for name, episodes in kept.items():
            console.print(f"{name:>16}  {_said(specs[name].make(self.split), episodes)}")


def solve_missing(
    specs: Mapping[str, ScenarioSpec],
    split: str,
    seeds: Mapping[str, Iterable[int]],
    folder: Path,
    place: Place,
    console: Console,
) -> dict[str, dict[int, dict[str, Any]]]:
    """Solve the episodes that a folder lacks, and store each one when it is solved.

    Parameters
    ----------
    specs
        Scenarios by name.
    split
        Split of the episodes.
    seeds
        Seeds by scenario name.
    folder
        Folder with ``hindsight_file`` of each name; created if missing.
    place
        Where the episodes are solved.
    console
        Console for the progress bar.

    Returns
    -------
    dict
        Records of all episodes in the file, by scenario name and seed.

    Raises
    ------
    ValueError
        If a file is damaged or belongs to another scenario of that name (before anything is solved), or if hindsight
        does not support the scenario. LostUnits if episodes have no result.
    LockedError
        If another command is writing to this folder.
    """
    from dcgrid_env.baselines.carried import carried
    from dcgrid_env.baselines.hindsight_costs import hindsight_file
    from dcgrid_env.core.work.unit import Unit

    def kept_now() -> dict[str, dict[int, dict[str, Any]]]:
        return {name: kept_episodes(folder, spec.make(split)) for name, spec in specs.items()}

    kept_now()  # raise ValueError before a folder is created
    with alone_in(folder, "dcgrid hindsight"), progress_bar(console) as progress:
        kept = kept_now()
        due = [(specs[name], seed) for name in specs for seed in seeds[name] if seed not in kept[name]]
        bar = progress.add_task("episodes", total=len(due))
        units = [Unit(f"{t[0].make(split).name}, seed {t[1]}", partial(solve, split), t) for t in due]
        for unit, record in place.results(units, carried(place, [spec.where for spec in specs.values()])):
            spec, seed = unit.item
            name = spec.make(split).name
            kept[name][seed] = record
            _write(hindsight_file(folder, name), spec, split, kept[name])
            progress.advance(bar)
    return kept


def solve(split: str, task: tuple[ScenarioSpec, int]) -> dict[str, Any]:
    """Return the record of one episode for a scenario and a seed."""
    from dcgrid_env import episode_hash
    from dcgrid_env.baselines.model_based.hindsight import hindsight

    spec, seed = task
    scenario = spec.make(split)
    solved = hindsight(scenario, seed)
    return {
        "seed": seed,
        "hash": episode_hash(scenario, seed),
        "J": solved.J,
        "bound": solved.bound,
        "rounds": solved.rounds,
    }


def _said(scenario: Scenario, episodes: dict[int, dict[str, Any]]) -> str:
    """Return a summary of a scenario's file on one line."""
    from dcgrid_env.baselines.model_based.hindsight import effort_of, finds_best_known

    rounds, settled = effort_of(scenario)
    j = [episode["J"] for episode in episodes.values()]
    gaps = [abs(episode["J"] - episode["bound"]) / max(abs(episode["J"]), 1e-12) for episode in episodes.values()]
    most = sum(e["rounds"] >= rounds and gap > settled for e, gap in zip(episodes.values(), gaps, strict=True))
    missing = max(episodes) + 1 - len(episodes)
    stopped = f"{most} stopped after {rounds} programs with a gap above {settled:g} of J"
    if finds_best_known(scenario):
        stopped = f"{sum(gap > settled for gap in gaps)} above {settled:g} of J"
    return (
        f"{len(j)} episodes, mean J {sum(j) / len(j):.4f}, largest gap to the bound {max(gaps):.1e} of J, {stopped}"
        + f"; {missing} of the seeds 0 to {max(episodes)} are missing" * (missing > 0)
    )


def kept_episodes(folder: Path, scenario: Scenario, best_known: bool = False) -> dict[int, dict[str, Any]]:
    """Return the episodes of a scenario in a folder, by seed.

    Raises ValueError if the file is damaged, belongs to another scenario, or is not of the requested kind:
    ``best_known`` requests best known costs without bounds, otherwise the costs that ``dcgrid hindsight`` writes.
    """
    from dcgrid_env import scenario_hash
    from dcgrid_env.baselines.hindsight_costs import hindsight_file, is_without_bounds, read_hindsight

    content = read_hindsight(folder, scenario.name)
    if content is None:
        return {}
    if is_without_bounds(content) != best_known:
        contents = "hindsight costs" if best_known else "best known costs"
        raise ValueError(f"out: {hindsight_file(folder, scenario.name)} contains {contents}; choose another --out")
    if content["scenario_hash"] != scenario_hash(scenario):
        raise ValueError(
            f"out: {hindsight_file(folder, scenario.name)} belongs to a different scenario named {scenario.name}; move "
            "the file, or choose another --out or another name (--set name=...)"
        )
    return {episode["seed"]: episode for episode in content["episodes"]}


def _write(path: Path, spec: ScenarioSpec, split: str, episodes: dict[int, dict[str, Any]]) -> None:
    from dcgrid_env import scenario_hash
    from dcgrid_env.baselines.hindsight_costs import BEST_KNOWN
    from dcgrid_env.baselines.model_based.hindsight import GAP_BEST_KNOWN, finds_best_known

    scenario, count = spec.make(split), max(episodes) + 1
    is_far = any(one["J"] - one["bound"] > GAP_BEST_KNOWN * abs(one["J"]) for one in episodes.values())
    command = f"dcgrid hindsight {spec.options('--scenarios')} --split {split} --episodes {count}"
    write_json(
        path,
        {
            "scenario": scenario.name,
            "split": scenario.split,
            **({"kind": BEST_KNOWN} if is_far and finds_best_known(scenario) else {}),
            "scenario_hash": scenario_hash(scenario),
            "command": command,
            "versions": meta()["versions"],
            "episodes": [episodes[seed] for seed in sorted(episodes)],
        },
    )
