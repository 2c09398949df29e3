"""The command ``dcgrid benchmark``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcgrid_env.baselines.registry import tuned_from
from dcgrid_env.baselines.scenario_names import scenario_specs
from dcgrid_env.core.commands.command import GOES_ON
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.opening import offer
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import Overrides, Scenarios, alone_in
from dcgrid_env.core.commands.terminal import plain_console
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from rich.console import Console

    from dcgrid_env.apps.benchmark.gather import Results
    from dcgrid_env.apps.benchmark.jobs import Case, Task, Unit
    from dcgrid_env.apps.benchmark.store import Store
    from dcgrid_env.core.work.unit import Lost, Place


@dataclass(frozen=True)
class Benchmark(OverWorkers):
    """Score controllers on the test split of scenarios.

    Writes results.json, results.md and report.html, and prints the table of scores.

    Finished units are kept in OUT/units. Run an interrupted benchmark again to resume, or add controllers, scenarios or
    episodes to it; the output files contain the last command's selection. Results of a changed controller are computed
    again. The command refuses an OUT from another package version or a changed scenario.
    """

    scenarios: Scenarios = "all"
    """Scenarios, separated by commas: names (dcgrid list), path/to/file.toml, path/to/file.py:function or
    package.module:function; or all for every preset."""
    set: Overrides = ()
    """Fields to override in every scenario, for example --set horizon=60 sensing.noise_pu=0.005."""
    controllers: str = "local"
    """Controllers, separated by commas: names (dcgrid list), your classes (module:Class or file.py:Class, for example
    'file.py:Class(gain=0.5)'), training run folders or policy files (.safetensors). Groups: local (hand-written, only
    local measurements), all (all hand-written) and policies (bundled policies). The tuned droop is always included.
    Paths must not contain commas."""
    episodes: int = 100
    """Number of test episodes for each scenario, with seeds 0, 1, ... Scores need hindsight costs: the presets include
    those of the first 100 episodes, and dcgrid hindsight stores others in results/hindsight."""
    tuned: Path | None = None
    """File with the gains of the tuned controllers, written by dcgrid tune. Default: results/tuned.json if it has gains
    for this exact scenario, otherwise the gains bundled with the preset."""
    out: Path = Path("results/benchmark")
    """Output folder. Created if missing."""
    open: bool = False
    """Open the report when the command ends."""

    def run(self) -> None:
        """Run the remaining units and write the results; raise ValueError first if a setting is invalid."""
        from dcgrid_env.apps.benchmark.gather import gather
        from dcgrid_env.apps.benchmark.jobs import Case, plan
        from dcgrid_env.apps.benchmark.store import Store
        from dcgrid_env.baselines import published
        from dcgrid_env.baselines.carried import carried
        from dcgrid_env.baselines.hindsight_costs import FOLDER
        from dcgrid_env.baselines.score import SPLIT
        from dcgrid_env.baselines.tuning.tuned import require_tuned
        from dcgrid_env.core.work.unit import require_all

        require_tuned(self.tuned)
        place = self.place
        cases = [Case(spec, self.tuned) for spec in scenario_specs(self.scenarios, self.set, SPLIT).values()]
        controllers = _controllers(self.controllers, cases[0])
        tasks, failures = plan(cases, controllers, self.episodes)
        store = Store(self.out)
        done = {task.unit: record for task in tasks if (record := store.get(task.unit))}
        console = plain_console()
        for line in _beforehand(cases, controllers, self, failures):
            console.print(line)
        if done:
            console.print(f"{len(done)} of {len(tasks)} units with these settings are already in {store.folder}")
        try:
            with alone_in(self.out, "dcgrid benchmark"):
                shared = carried(place, [case.spec.where for case in cases], controllers, self.tuned)
                due = [task for task in tasks if task.unit not in done]
                failed, lost = _run(due, done, store, place, shared, console)
                failures |= failed
                with console.status("checking the episode hashes and summarising"):
                    results = gather(cases, controllers, self.episodes, done, failures, lambda s: published(s, FOLDER))
                _write(self, results, place, shared, console)
        except KeyboardInterrupt:
            console.print(f"interrupted with {len(done)} of {len(tasks)} units done; {GOES_ON}")
            raise SystemExit(130) from None
        require_all(lost, len(tasks))


def _beforehand(
    cases: Sequence[Case], controllers: Sequence[str], cfg: Benchmark, failures: dict[tuple[str, str], str]
) -> list[str]:
    """Return lines on missing data for scores, with the commands that create it, and on gains that are not bundled."""
    from dcgrid_env.apps.benchmark.gather import no_hindsight
    from dcgrid_env.baselines import published
    from dcgrid_env.baselines.hindsight_costs import FOLDER
    from dcgrid_env.baselines.score import REFERENCE

    said = []
    for case in cases:
        name = case.scenario().name
        lacks = failures.get((name, REFERENCE)), no_hindsight(case, cfg.episodes, lambda s: published(s, FOLDER))
        said += [f"{name} will have no score: {reason}" for reason in lacks if reason]
        said += tuned_from([c for c in controllers if (name, c) not in failures], case.scenario(), cfg.tuned)
    return said


def _controllers(names_text: str, case: Case) -> list[str]:
    """Return the controllers in table order: the reference, static rules, then the order of the option."""
    from dcgrid_env.agents.controllers import TRAINED
    from dcgrid_env.baselines import CONTROLLERS, TUNED
    from dcgrid_env.baselines.score import REFERENCE, STATIC

    by_hand = [*CONTROLLERS, *TUNED]
    groups = {"all": by_hand, "policies": [*TRAINED]}
    names: list[str] = []
    for name in split_names(names_text):
        names += filter(_is_local, by_hand) if name == "local" else groups.get(name, [name])
    if not names:
        raise ValueError(
            f"controllers: must name at least one, got {names_text!r}; choose names (dcgrid list), local, all "
            "or policies"
        )
    for name in names:
        if name not in by_hand and name not in TRAINED:
            case.controller(name)  # raise ValueError if it is not a controller
    return list(dict.fromkeys([REFERENCE, *(name for name in STATIC if name in names), *names]))


def _is_local(name: str) -> bool:
    """Return whether a controller uses only local measurements, on the first preset that it supports."""
    from dcgrid_env import PRESETS
    from dcgrid_env.apps.benchmark.jobs import Case, observed
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

    for preset in PRESETS:
        case = Case(ScenarioSpec(preset))
        try:
            return observed(case.controller(name), case.scenario()) == "local"
        except ValueError:
            continue
    return True


def _run(
    tasks: Sequence[Task],
    done: dict[Unit, dict[str, Any]],
    store: Store,
    place: Place,
    shared: dict[str, Any],
    console: Console,
) -> tuple[dict[tuple[str, str], str], dict[str, Lost]]:
    """Run tasks, and store each unit's record when it is done.

    Returns failures by (scenario, controller), and the units that were lost with their workers, by name.
    """
    from dcgrid_env.apps.benchmark.jobs import run
    from dcgrid_env.core.work import unit as work

    failed: dict[Unit, str] = {}
    lost: dict[str, Lost] = {}
    units = [work.Unit(task.unit.label, run, task) for task in tasks]
    with progress_bar(console) as progress:
        before = sum(unit.episodes for unit in done)
        total = before + sum(task.unit.episodes for task in tasks)
        bar = progress.add_task("episodes", total=total, completed=before)
        for finished, record in place.run(units, shared):
            unit = finished.item.unit
            if isinstance(record, work.Lost):
                failed[unit] = f"failed: {record.reason}"
                lost[finished.key] = record
            elif "failure" in record:
                failed[unit] = record["failure"]
            else:
                store.put(unit, record)
                done[unit] = record
            progress.advance(bar, unit.episodes)
    first = sorted(failed, key=lambda unit: -unit.first)  # the first unit of a pair comes last and is kept
    return {(unit.scenario, unit.controller): failed[unit] for unit in first}, lost


def _write(cfg: Benchmark, results: Sequence[Results], place: Place, shared: dict[str, Any], console: Console) -> None:
    """Write the files, records before figures, and print the scores."""
    from dcgrid_env import scenario_hash
    from dcgrid_env.apps.benchmark.benchmark_tables import saved_table, score_table
    from dcgrid_env.apps.benchmark.output import write_report, write_results
    from dcgrid_env.baselines.score import SPLIT

    hashes = {result.summary.scenario: scenario_hash(result.case.scenario()) for result in results}
    about = meta() | {"split": SPLIT, "episodes": cfg.episodes, "scenarios": hashes}
    write_results(cfg.out, results, about)
    with console.status("drawing the report"):
        write_report(cfg.out, results, place, shared, about)
    summaries = [result.summary for result in results]
    console.print(score_table(summaries, interval=False).rich(console.width))
    console.print(saved_table(summaries).rich(console.width))
    for note in score_table(summaries).notes:
        console.print(note)
    for row in (row for result in results for row in result.summary.rows if row.failure):
        console.print(f"{row.scenario}, {row.controller}: {row.failure}")
    console.print(f"wrote results.json, results.md and report.html in {cfg.out}")
    offer(console, cfg.out / "report.html", cfg.open)
