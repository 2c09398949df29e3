"""The command ``dcgrid dev best-known``."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from dcgrid_env.cli.hindsight import kept_episodes
from dcgrid_env.cli.names import split_names
from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.settings import Overrides, alone_in
from dcgrid_env.cli.terminal import plain_console
from dcgrid_env.cli.workers import OverWorkers
from dcgrid_env.core.files import write_json
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

EPISODES = 25
"""Episodes of a task."""


@dataclass(frozen=True)
class BestKnownValues(OverWorkers):
    """Search the least cost of episodes in which sites trip or smooth their power, which no linear program plans.

    Each episode is searched by itself, with all of it known: the times, pace and gains of a staggered return are fitted
    to it, or the floors, ramps and gains of fixed smoothing. Named controllers are asked too, and the least of all
    counts. It is written in the place of hindsight's costs, marked as best known: it bounds nothing, and whoever
    reaches less makes it lower. Episodes that stand in the file are not searched again; controllers are asked anew.
    """

    scenario: str = "ride-through"
    """Name of a scenario, path/to/file.toml, or path/to/file.py:function or package.module:function that
    makes your own; its sites must have a channel return and a staggered-return tuned by dcgrid tune, or a
    channel floor and a smoothing tuned."""
    set: Overrides = ()
    """Fields of the scenario that are to be otherwise, for instance --set horizon=60 voltage_noise_pu=0.005."""
    controllers: str = "none,return-by-hand-tuned,staggered-return-tuned"
    """Who is asked besides, separated by commas: names or files, see dcgrid list."""
    episodes: int = 100
    """Number of episodes: seeds 0, 1, .."""
    split: str = "test"
    """Which episodes the seeds mean: train, validation or test."""
    out: Path = Path("results/hindsight")
    """Folder for SCENARIO.json."""

    def run(self) -> None:
        """Search and write. ValueError for a setting that cannot be, or a file damaged or of another scenario."""
        from dcgrid_env.baselines.carried import carried
        from dcgrid_env.baselines.hindsight_costs import hindsight_file
        from dcgrid_env.baselines.scenario_spec import ScenarioSpec
        from dcgrid_env.core.work.unit import Unit

        if self.episodes < 1:
            raise ValueError(f"episodes is {self.episodes}; give at least 1")
        spec, names = ScenarioSpec(self.scenario, self.set), split_names(self.controllers)
        place, scenario, console = self.place, spec.make(self.split), plain_console()
        kept, seeds = kept_episodes(self.out, scenario), range(self.episodes)
        parts = [seeds[i : i + EPISODES] for i in seeds[::EPISODES]]
        tasks = [Task(spec, self.split, own, tuple(names), {i: kept[i] for i in own if i in kept}) for own in parts]
        records: dict[int, dict[str, Any]] = {}
        with alone_in(self.out, "dcgrid dev best-known"), progress_bar(console) as progress:
            bar = progress.add_task("episodes", total=self.episodes)
            units = [Unit(f"{scenario.name}, seeds {t.seeds[0]} to {t.seeds[-1]}", search, t) for t in tasks]
            for unit, found in place.results(units, carried(place, [spec.where], names), how_to_go_on=""):
                records |= found
                progress.advance(bar, len(unit.item.seeds))
            write_json(hindsight_file(self.out, scenario.name), self._content(spec, records))
        j = [record["J"] for record in records.values()]
        by = [record["by"] for record in records.values()]
        shares = ", ".join(f"{name} {by.count(name)}" for name in dict.fromkeys(by))
        console.print(f"{scenario.name}: {len(j)} episodes, mean J {sum(j) / len(j):.4f}, found by {shares}")

    def _content(self, spec: ScenarioSpec, records: dict[int, dict[str, Any]]) -> dict[str, Any]:
        """What the file holds."""
        from dcgrid_env import scenario_hash
        from dcgrid_env.baselines.hindsight_costs import BEST_KNOWN

        scenario = spec.make(self.split)
        options = f"--split {self.split} --episodes {self.episodes} --controllers {shlex.quote(self.controllers)}"
        return {
            "kind": BEST_KNOWN,
            "scenario": scenario.name,
            "split": scenario.split,
            "scenario_hash": scenario_hash(scenario),
            "command": f"dcgrid dev best-known {spec.options('--scenario')} {options}",
            "versions": meta()["versions"],
            "episodes": [records[seed] for seed in sorted(records)],
        }


class Task(NamedTuple):
    """Episodes that are searched together."""

    spec: ScenarioSpec
    split: str
    seeds: range
    controllers: tuple[str, ...]
    kept: dict[int, dict[str, Any]]
    """Records of those that have been searched."""


def search(task: Task) -> dict[int, dict[str, Any]]:
    """The records of some episodes, by seed."""
    from dcgrid_env import episode_hash
    from dcgrid_env.agents import find_controller
    from dcgrid_env.baselines.tuning.best_known import Searched, best_known

    scenario = task.spec.make(task.split)
    asked = {name: find_controller(name, scenario) for name in task.controllers}
    searched = {seed: Searched(record["searched_J"], tuple(record["x"])) for seed, record in task.kept.items()}
    found = best_known(scenario, list(task.seeds), asked, searched)
    return {
        seed: {
            "seed": seed,
            "hash": episode_hash(scenario, seed),
            "J": best.J,
            "by": best.by,
            "searched_J": best.searched.J,
            "x": list(best.searched.x),
        }
        for seed, best in zip(task.seeds, found, strict=True)
    }
