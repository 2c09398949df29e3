"""Solve episodes with perfect foresight and keep what they cost: one JSON file a scenario, resumed where it stopped.

A file is written after each episode. The command in it is the one that gives all its episodes, seeds 0 to the largest
one there; where an interruption left a hole between them, that command fills it.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcgrid_env.commands.named import scenario_names
from dcgrid_env.commands.progress import progress_bar
from dcgrid_env.commands.results import meta, write_json
from dcgrid_env.commands.settings import check_folder, processes

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
    """Solve what is missing. ValueError for a setting that cannot be, or a file damaged or of another scenario."""
    from rich.console import Console

    from dcgrid_env import make_scenario
    from dcgrid_env.benchmark.pool import Died, each

    if cfg.episodes < 1:
        raise ValueError(f"episodes is {cfg.episodes}; give at least 1")
    jobs = processes(cfg.jobs)
    scenarios = {name: make_scenario(name, split=cfg.split) for name in scenario_names(cfg.scenarios)}
    kept = {name: _kept(cfg.out / f"{name}.json", scenario) for name, scenario in scenarios.items()}
    check_folder(cfg.out)
    due = [(name, seed) for name in scenarios for seed in range(cfg.episodes) if seed not in kept[name]]
    console = Console()
    with progress_bar(console) as progress:
        bar = progress.add_task("episodes", total=len(due))
        for (name, seed), found in each(partial(solve, cfg.split), due, jobs):
            if isinstance(found, Died):
                raise OSError(f"the process that solved {name}, seed {seed}, ended with code {found.exit_code}")
            kept[name][seed] = found
            _write(cfg.out / f"{name}.json", scenarios[name], kept[name])
            progress.advance(bar)
    for name, episodes in kept.items():
        console.print(f"{name:>16}  {_said(episodes)}", highlight=False)


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


def _said(episodes: dict[int, dict[str, Any]]) -> str:
    """Sum of a scenario's file on one line."""
    from dcgrid_env.baselines.hindsight import ROUNDS, TOLERANCE

    j = [episode["J"] for episode in episodes.values()]
    gaps = [abs(episode["J"] - episode["bound"]) / max(abs(episode["J"]), 1e-12) for episode in episodes.values()]
    most = sum(e["rounds"] >= ROUNDS and gap > TOLERANCE for e, gap in zip(episodes.values(), gaps, strict=True))
    missing = max(episodes) + 1 - len(episodes)
    return (
        f"{len(j)} episodes, mean J {sum(j) / len(j):.4f}, largest gap to the bound {max(gaps):.1e} of J, "
        f"{most} stopped at {ROUNDS} programs with a gap above {TOLERANCE:g} of J"
        + f"; {missing} of the seeds 0 to {max(episodes)} are missing"
        * (missing > 0)
    )


def _kept(path: Path, scenario: Scenario) -> dict[int, dict[str, Any]]:
    """Episodes that stand in a file; ValueError, which names it, for one of another scenario or a damaged one."""
    from dcgrid_env import scenario_hash

    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise _damaged(path, f"is no JSON ({error})") from None
    if not isinstance(content, dict) or not {"scenario_hash", "episodes"} <= set(content):
        raise _damaged(path, "has no 'scenario_hash' and 'episodes'")
    if content["scenario_hash"] != scenario_hash(scenario):
        raise ValueError(f"{path} is of another {scenario.name}; move it away, or choose another --out")
    if not isinstance(content["episodes"], list):
        raise _damaged(path, "has 'episodes' that are no list")
    for place, episode in enumerate(content["episodes"]):
        if wrong := _wrong(episode):
            raise _damaged(path, f"has {wrong} in its episode at place {place}")
    return {episode["seed"]: episode for episode in content["episodes"]}


def _damaged(path: Path, wrong: str) -> ValueError:
    return ValueError(f"{path} {wrong}; delete it, or choose another --out")


def _wrong(episode: Any) -> str | None:
    """What is missing in an episode's record, or not what it should be; None if it is whole."""
    kinds = {"seed": int, "hash": str, "J": float, "bound": float, "rounds": int}
    if not isinstance(episode, dict):
        return "no record"
    for key, kind in kinds.items():
        if key not in episode:
            return f"no {key!r}"
        value = episode[key]
        if not isinstance(value, kind) or (kind is float and not math.isfinite(value)):
            return f"{key} = {value!r}"
    return None


def _write(path: Path, scenario: Scenario, episodes: dict[int, dict[str, Any]]) -> None:
    from dcgrid_env import scenario_hash

    count = max(episodes) + 1
    command = f"dcgrid hindsight --scenarios {scenario.name} --split {scenario.split} --episodes {count}"
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
