"""The command ``python -m docs.studies best-known``."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env import episode_hash, scenario_hash
from dcgrid_env.agents import find_controller
from dcgrid_env.baselines.carried import carried
from dcgrid_env.baselines.hindsight_command import kept_episodes
from dcgrid_env.baselines.hindsight_costs import BEST_KNOWN, hindsight_file
from dcgrid_env.baselines.recorded_actions import actions_file, checksum, packed, recorded_actions
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.core.commands.command import GOES_ON
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import Overrides, alone_in
from dcgrid_env.core.commands.terminal import plain_console
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.files import write_bytes, write_json
from dcgrid_env.core.versions import meta
from dcgrid_env.core.work.unit import Unit
from docs.studies.best_known.action_search import Known, best_known
from docs.studies.commands import PROG

EPISODES = 16
"""Episodes of a task."""


@dataclass(frozen=True)
class BestKnownValues(OverWorkers):
    """Search for the least cost where no linear program applies.

    These are scenarios in which sites trip or smooth their power.

    Each episode is searched alone and over its actions, with all of it known. The search starts from the best
    trajectory of the named controllers, or from the one in the file, whichever costs less. The costs replace
    hindsight's and are marked as best known. The actions are written next to them. The costs are not a bound: the same
    command goes on from what the file contains, and never makes a cost higher.
    """

    scenario: str = "ride-through"
    """Name of a scenario, path/to/file.toml, or path/to/file.py:function or package.module:function that
    makes your own; its sites must have a channel return or a channel floor."""
    set: Overrides = ()
    """Scenario fields to override, for instance --set horizon=60 sensing.noise_pu=0.005."""
    controllers: str = "droop-tuned"
    """Controllers to begin with, separated by commas: names or files, see dcgrid list."""
    rounds: int = 10
    """Rounds of the search: passes over the blocks of an episode where sites return, 4 steps of the descent where
    they smooth their power."""
    episodes: int = 32
    """Number of episodes: seeds 0, 1, .."""
    split: str = "test"
    """Which episodes the seeds mean: train, validation or test."""
    out: Path = Path("results/hindsight")
    """Folder for SCENARIO.json and SCENARIO.actions.xz."""

    @property
    def resumes(self) -> str:
        """How to continue; the search starts from the best that has been found."""
        return GOES_ON

    def run(self) -> None:
        """Search and write. ValueError for an invalid setting, or a file that is damaged or of another scenario."""
        if self.episodes < 1:
            raise ValueError(f"episodes is {self.episodes}; give at least 1")
        if self.rounds < 0:
            raise ValueError(f"rounds is {self.rounds}; give at least 0")
        spec, names = ScenarioSpec(self.scenario, self.set), split_names(self.controllers)
        place, scenario, console = self.place, spec.make(self.split), plain_console()
        kept_episodes(self.out, scenario, best_known=True)  # ValueError before a folder is made
        seeds = range(self.episodes)
        parts = [seeds[i : i + EPISODES] for i in seeds[::EPISODES]]
        with alone_in(self.out, f"{PROG} best-known"), progress_bar(console) as progress:
            kept = kept_episodes(self.out, scenario, best_known=True)
            actions = recorded_actions(scenario, self.out) if kept else {}
            found = {
                seed: Known(record["J"], record["start"], record["rounds"], actions[seed])
                for seed, record in kept.items()
            }
            tasks = [
                Task(spec, self.split, part, tuple(names), self.rounds, {i: found[i] for i in part if i in found})
                for part in parts
            ]
            bar = progress.add_task("episodes", total=self.episodes)
            units = [Unit(f"{scenario.name}, seeds {t.seeds[0]} to {t.seeds[-1]}", search, t) for t in tasks]
            for unit, known in place.results(units, carried(place, [spec.where], names)):
                found |= known
                self._write(spec, found)
                progress.advance(bar, len(unit.item.seeds))
        j = [found[seed].J for seed in seeds]
        console.print(f"{scenario.name}: {len(j)} episodes, mean J {sum(j) / len(j):.4f}")

    def _write(self, spec: ScenarioSpec, found: dict[int, Known]) -> None:
        """Write the actions, then the costs, which name the hash of the actions."""
        scenario, seeds = spec.make(self.split), sorted(found)
        options = f"--split {self.split} --episodes {self.episodes} --controllers {shlex.quote(self.controllers)}"
        content = packed(np.stack([found[seed].actions for seed in seeds]))
        write_bytes(actions_file(self.out, scenario.name), content)
        described: dict[str, Any] = {
            "kind": BEST_KNOWN,
            "scenario": scenario.name,
            "split": scenario.split,
            "scenario_hash": scenario_hash(scenario),
            "command": f"{PROG} best-known {spec.options('--scenario')} {options} --rounds {self.rounds}",
            "versions": meta()["versions"],
            "actions_sha256": checksum(content),
            "episodes": [
                {
                    "seed": seed,
                    "hash": episode_hash(scenario, seed),
                    "J": found[seed].J,
                    "start": found[seed].start,
                    "rounds": found[seed].rounds,
                }
                for seed in seeds
            ],
        }
        write_json(hindsight_file(self.out, scenario.name), described)


class Task(NamedTuple):
    """Episodes that are searched together."""

    spec: ScenarioSpec
    split: str
    seeds: range
    controllers: tuple[str, ...]
    rounds: int
    known: dict[int, Known]
    """What is known of episodes so far."""


def search(task: Task) -> dict[int, Known]:
    """What is known of some episodes after the search, by seed."""
    scenario = task.spec.make(task.split)
    controllers = {name: find_controller(name, scenario) for name in task.controllers}
    found = best_known(scenario, list(task.seeds), controllers, task.known, task.rounds)
    return dict(zip(task.seeds, found, strict=True))
