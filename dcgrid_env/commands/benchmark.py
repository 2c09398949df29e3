"""Run controllers over scenarios on the test split and score them: a table, results.json, results.md and report.html.

Finished units are kept in OUT/units: an interrupted benchmark goes on where it was, and more controllers, scenarios or
episodes can be added by the same command; the files hold what the last one asked for. An OUT of another version of the
package or of a changed scenario is refused; units of a controller that has changed are computed anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcgrid_env.commands.named import scenario_names, split_names
from dcgrid_env.commands.progress import progress_bar
from dcgrid_env.commands.results import meta
from dcgrid_env.commands.settings import processes

if TYPE_CHECKING:
    from rich.console import Console

    from dcgrid_env.benchmark.gather import Results
    from dcgrid_env.benchmark.jobs import Unit
    from dcgrid_env.benchmark.store import Store

MOST_EPISODES = 100
"""Test episodes that are published, seeds 0 to 99."""
STATIC = ("constant-q-tuned", "placement-tuned")
"""The simplest rivals of a learner; where they are run they stand just below the reference."""


@dataclass(frozen=True)
class Benchmark:
    """What to run."""

    scenarios: str = "all"
    """Names of scenarios, separated by commas, or all (dcgrid list)."""
    controllers: str = "local"
    """Separated by commas: names (dcgrid list), module:Class or file.py:Class of your own, saved policies
    (.safetensors); local (made by hand, without a model of the feeder), all (made by hand) or policies (those that
    ship). A path must not hold a comma. The tuned droop is run besides."""
    episodes: int = MOST_EPISODES
    """Test episodes of each scenario, seeds 0, 1, ...; at most the published 100."""
    out: Path = Path("results/benchmark")
    """Folder for what is written; made if it is not there."""
    jobs: int | None = None
    """Processes; by default one for each core."""


def main(cfg: Benchmark) -> None:
    """Run what is not done yet, sum up, write the files. ValueError for bad settings, before anything is written."""
    from rich.console import Console

    from dcgrid_env.baselines import published
    from dcgrid_env.benchmark.gather import gather
    from dcgrid_env.benchmark.jobs import plan
    from dcgrid_env.benchmark.store import Store

    if not 1 <= cfg.episodes <= MOST_EPISODES:
        raise ValueError(f"episodes is {cfg.episodes}; give 1 to {MOST_EPISODES}, the published test episodes")
    jobs = processes(cfg.jobs)
    scenarios = scenario_names(cfg.scenarios)
    controllers = _controllers(cfg.controllers, scenarios[0])
    units, failures = plan(scenarios, controllers, cfg.episodes)
    store = Store(cfg.out)
    done = {unit: record for unit in units if (record := store.get(unit))}
    console = Console()
    if done:
        console.print(f"{len(done)} of {len(units)} units are done already with these settings, in {store.folder}")
    try:
        failures |= _run(units, done, store, jobs, console)
        with console.status("checking the episodes' hashes and summing up"):
            results = gather(scenarios, controllers, cfg.episodes, done, failures, published)
        _write(cfg, results, jobs, console)
    except KeyboardInterrupt:
        console.print(f"interrupted with {len(done)} of {len(units)} units done; the same command goes on from there")
        raise SystemExit(130) from None


def _controllers(asked: str, scenario: str) -> list[str]:
    """The controllers in the order of the tables: the reference, static rules, then as asked for."""
    from dcgrid_env.agents.find import NAMES, TRAINED, find_controller
    from dcgrid_env.benchmark.jobs import on_test_split
    from dcgrid_env.benchmark.summary import REFERENCE

    by_hand = [name for name in NAMES if name not in TRAINED]
    groups = {"all": by_hand, "policies": [*TRAINED]}
    names: list[str] = []
    for name in split_names(asked):
        names += filter(_is_local, by_hand) if name == "local" else groups.get(name, [name])
    if not names:
        raise ValueError(f"controllers is {asked!r}; name at least one, local, all or policies (dcgrid list)")
    for name in names:
        if name not in NAMES:
            find_controller(name, on_test_split(scenario))  # ValueError for what is none
    return list(dict.fromkeys([REFERENCE, *(name for name in STATIC if name in names), *names]))


def _is_local(name: str) -> bool:
    """Whether a controller sees local figures alone, on the first scenario that it can be made for."""
    from dcgrid_env import PRESETS
    from dcgrid_env.agents.find import find_controller
    from dcgrid_env.benchmark.jobs import observed, on_test_split

    for preset in PRESETS:
        try:
            return observed(find_controller(name, on_test_split(preset)), on_test_split(preset)) == "local"
        except ValueError:
            continue
    return True


def _run(
    units: Sequence[Unit], done: dict[Unit, dict[str, Any]], store: Store, jobs: int, console: Console
) -> dict[tuple[str, str], str]:
    """Run what is not done, keeping each unit at once; what failed, by (scenario, controller)."""
    from dcgrid_env.benchmark.jobs import run
    from dcgrid_env.benchmark.pool import Died, each

    failed: dict[Unit, str] = {}
    with progress_bar(console) as progress:
        bar = progress.add_task(
            "episodes", total=sum(u.episodes for u in units), completed=sum(u.episodes for u in done)
        )
        for unit, record in each(run, [unit for unit in units if unit not in done], jobs):
            if isinstance(record, Died):
                failed[unit] = f"failed: its process ended with exit code {record.exit_code}"
            elif "failure" in record:
                failed[unit] = record["failure"]
            else:
                store.put(unit, record)
                done[unit] = record
            progress.advance(bar, unit.episodes)
    first = sorted(failed, key=lambda unit: -unit.first)  # the pair's first unit is put in last, and stays
    return {(unit.scenario, unit.controller): failed[unit] for unit in first}


def _write(cfg: Benchmark, results: Sequence[Results], jobs: int, console: Console) -> None:
    """The files, the records before the figures, and the scores on the terminal."""
    from dcgrid_env import scenario_hash
    from dcgrid_env.benchmark.jobs import SPLIT, on_test_split
    from dcgrid_env.benchmark.tables import score_table
    from dcgrid_env.benchmark.write import write_report, write_results

    names = [result.summary.scenario for result in results]
    hashes = {name: scenario_hash(on_test_split(name)) for name in names}
    about = meta() | {"split": SPLIT, "episodes": cfg.episodes, "scenarios": hashes}
    write_results(cfg.out, results, about)
    with console.status("drawing the report"):
        write_report(cfg.out, results, jobs, about)
    summaries = [result.summary for result in results]
    console.print(score_table(summaries, interval=False).rich(console.width))
    for note in score_table(summaries).notes:
        console.print(note, highlight=False, markup=False)
    for row in (row for result in results for row in result.summary.rows if row.failure):
        console.print(f"{row.scenario}, {row.controller}: {row.failure}", highlight=False, markup=False)
    console.print(f"wrote results.json, results.md and report.html in {cfg.out}", highlight=False, markup=False)
