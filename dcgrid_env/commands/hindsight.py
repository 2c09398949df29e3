"""Solve episodes with perfect foresight and keep what they cost: one JSON file a scenario, resumed where it stopped."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcgrid_env.commands.named import scenario_names
from dcgrid_env.commands.results import meta, write_json

if TYPE_CHECKING:
    from dcgrid_env import Scenario


@dataclass(frozen=True)
class HindsightValues:
    """What to solve."""

    scenarios: str = "all"
    """Names of scenarios separated by commas (dcgrid list), or all."""
    episodes: int = 100
    """Episodes of each: seeds 0, 1, .."""
    split: str = "test"
    """Which episodes the seeds mean: train, validation or test."""
    jobs: int | None = None
    """Processes; all cores by default."""
    out: Path = Path("results/hindsight")
    """Folder for SCENARIO.json; episodes that stand in it are not solved again."""


def main(cfg: HindsightValues) -> None:
    """Solve what is missing. ValueError for a setting that cannot be, or a file of another scenario."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    from dcgrid_env import make_scenario
    from dcgrid_env.benchmark.pool import Died, each
    from dcgrid_env.powerflow.threads import n_threads

    if cfg.episodes < 1:
        raise ValueError(f"episodes is {cfg.episodes}; give at least 1")
    scenarios = {name: make_scenario(name, split=cfg.split) for name in scenario_names(cfg.scenarios)}
    kept = {name: _kept(cfg.out / f"{name}.json", scenario) for name, scenario in scenarios.items()}
    due = [(name, seed) for name in scenarios for seed in range(cfg.episodes) if seed not in kept[name]]
    console = Console()
    columns = (
        TextColumn("{task.description:>16}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("episodes", total=len(due))
        for (name, seed), found in each(partial(solve, cfg.split), due, cfg.jobs or n_threads()):
            if isinstance(found, Died):
                raise OSError(f"the process that solved {name}, seed {seed}, ended with code {found.exit_code}")
            kept[name][seed] = found
            _write(cfg.out / f"{name}.json", scenarios[name], kept[name])
            progress.advance(task)
    for name, episodes in kept.items():
        j = [episode["J"] for episode in episodes.values()]
        gap = max(episode["J"] - episode["bound"] for episode in episodes.values())
        console.print(
            f"{name:>16}  {len(j)} episodes, mean J {sum(j) / len(j):.4f}, largest gap to the bound {gap:.1e}"
        )


def solve(split: str, task: tuple[str, int]) -> dict[str, Any]:
    """The record of one episode, given the scenario's name and the seed."""
    from dcgrid_env import episode_hash, make_scenario
    from dcgrid_env.baselines.hindsight import hindsight

    name, seed = task
    scenario = make_scenario(name, split=split)
    found = hindsight(scenario, seed)
    return {
        "seed": seed,
        "hash": episode_hash(scenario, seed),
        "J": found.J,
        "bound": found.bound,
        "rounds": found.rounds,
    }


def _kept(path: Path, scenario: Scenario) -> dict[int, dict[str, Any]]:
    from dcgrid_env import scenario_hash

    if not path.exists():
        return {}
    content = json.loads(path.read_text(encoding="utf-8"))
    if content["scenario_hash"] != scenario_hash(scenario):
        raise ValueError(f"{path} is of another {scenario.name}; move it away, or choose another --out")
    return {episode["seed"]: episode for episode in content["episodes"]}


def _write(path: Path, scenario: Scenario, episodes: dict[int, dict[str, Any]]) -> None:
    from dcgrid_env import scenario_hash

    command = f"dcgrid hindsight --scenarios {scenario.name} --split {scenario.split} --episodes {len(episodes)}"
    write_json(
        path,
        {
            "scenario": scenario.name,
            "split": scenario.split,
            "scenario_hash": scenario_hash(scenario),
            "command": command,
            "versions": meta()["versions"],
            "episodes": [episodes[seed] for seed in sorted(episodes)],
        },
    )
