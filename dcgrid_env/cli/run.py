"""The command ``dcgrid run``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.names import split_names
from dcgrid_env.cli.opening import offer
from dcgrid_env.cli.own_feeder import Asked, chosen_line, scenario_on_feeder
from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.runs import Runs
from dcgrid_env.cli.settings import Overrides, tuned_from, with_horizon
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.core.files import write_json
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from dcgrid_env import Scenario
    from dcgrid_env.baselines.benchmark.benchmark_tables import Table


@dataclass(frozen=True)
class Run(Command):
    """Run controllers on the same episodes and compare them.

    Prints a table of metrics and writes results.json and a figure.
    """

    scenario: str | None = None
    """Name of a scenario (dcgrid list), path/to/file.toml, or path/to/file.py:function or package.module:function that
    makes your own; without one and without --feeder it is ieee123."""
    feeder: str | None = None
    """Your own feeder: its folder (what dcgrid import writes, for instance), or the name of one that ships. What
    --datacenters and --inverters do not say is chosen to suit its load, the source's voltage so that it centres the
    band; all of it is printed and written as TOML, and --set changes any of it. With --scenario, that scenario's
    devices stand on this feeder."""
    datacenters: str | None = None
    """Data centres on --feeder: COUNT x SIZE kW or MW, then where: drawn in each episode (unless given), at ends, or at
    BUS,BUS; parts of different sizes joined by +, or none. For instance '3 x 1 MW at ends'."""
    inverters: str | None = None
    """Inverters on --feeder: COUNT x SIZE kvar, Mvar, kVA or MVA, then where: spread over the load buses (unless
    given), at ends, or at BUS,BUS; or none. For instance '5 x 200 kvar'."""
    save_scenario: Path | None = None
    """File to write what stands on --feeder to, instead of scenario.toml in the folder of --out."""
    set: Overrides = ()
    """Fields of the scenario that are to be otherwise, for instance --set horizon=60 sensing.noise_pu=0.005."""
    horizon: int | None = None
    """Steps of an episode instead of the scenario's own, as --set horizon=N has it; 86400 are a day of steps of 1 s."""
    controllers: str = "none,inverters,droop"
    """Controllers separated by commas: names, module:Class or file.py:Class of your own, in quotes with arguments, as
    'file.py:Class(gain=0.5)', training runs' folders or policies' files (.safetensors); guarded: before a policy keeps
    it near the tuned droop. A path must not hold a comma."""
    episodes: int = 8
    """Number of episodes for each controller: those of seeds seed, seed + 1, ..."""
    seed: int = 0
    """Seed of the first episode."""
    split: str = "test"
    """Which episodes the seeds mean: train, validation, test, or ood (another GPU or service)."""
    trace: str | None = None
    """Load of the data centres instead of the scenario's: a generator, or recordings and files separated by commas."""
    dvfs: Literal["linear", "prefill-decode"] | None = None
    """How the clock acts, the scenario's own way unless given: on all work alike, or by class of work (prefill and
    training follow it, decode hardly does)."""
    tuned: Path | None = None
    """File of dcgrid tune that the gains of tuned controllers must come from. Without it they are those of
    results/tuned.json where they were found for this very scenario, else those that ship with the preset."""
    course: Literal["auto", "parquet", "none"] = "auto"
    """Whether every step is written, to course/CONTROLLER/part-*.parquet in --out: auto where episodes are too long to
    be kept in memory, parquet always (both take the extra parquet), or none."""
    out: Path = Path("results/run")
    """Folder for results.json, figure.png and, with --feeder, scenario.toml; made if it is not there."""
    open: bool = False
    """Open the figure at the end."""

    def run(self) -> None:
        """Run, print the table, write. ValueError for an invalid setting, before anything is written."""
        from dcgrid_env import scenario_hash
        from dcgrid_env.agents.policy.guard import guard_line
        from dcgrid_env.baselines import find_controller
        from dcgrid_env.baselines.benchmark.jobs import episode_records
        from dcgrid_env.baselines.laws import stability
        from dcgrid_env.baselines.tuning.tuned import require_tuned
        from dcgrid_env.scenario.trace_scale import scaled_recordings, scaling_lines

        if self.episodes < 1 or self.seed < 0:
            raise ValueError(f"episodes is {self.episodes} and seed {self.seed}; give at least 1 and at least 0")
        _check_options(self)
        require_tuned(self.tuned)
        scenario = scenario_of(self)
        names = split_names(self.controllers)
        controllers = {name: find_controller(name, scenario, self.tuned) for name in names}
        if not controllers:
            raise ValueError(f"controllers is {self.controllers!r}; name at least one (dcgrid list)")
        seeds = range(self.seed, self.seed + self.episodes)
        console = plain_console()
        runs = Runs(scenario, seeds, self.course, self.out, console)
        with progress_bar(console) as progress:
            for name, controller in controllers.items():
                task = progress.add_task(name, total=scenario.horizon)
                runs.add(name, controller, lambda task=task: progress.advance(task))
        if self.feeder is not None:
            say(console, f"{chosen_line(scenario)}\n\n{scenario.replace(split='train').to_toml(brief=True)}")
        records = [
            record
            for name, metrics in runs.metrics.items()
            for record in episode_records(scenario.name, name, seeds, metrics)
        ]
        summed_up = table(scenario, records, names, self)
        console.print(summed_up.rich(console.width, fixed=2))
        for note in summed_up.notes:
            console.print(note)
        if scenario.power_flow == "distflow" and not runs.in_parts:  # which would run two long ones more
            console.print(linear_difference(scenario, seeds))
        for line in (*scaling_lines(scenario), *tuned_from(names, scenario, self.tuned)):
            console.print(line)
        for name, controller in controllers.items():
            if said := stability.warning(scenario.member(self.seed), controller):
                console.print(f"{name}: {said}")
            if line := guard_line(name, runs.metrics[name][0]):
                console.print(f"{line} (first episode)")
        about = meta() | {"split": self.split, "scenario_hash": scenario_hash(scenario), "trace": _origin(scenario)}
        about["trace_scale"] = [recording._asdict() for recording in scaled_recordings(scenario)]
        write_json(self.out / "results.json", {"meta": about, "episodes": records})
        runs.draw(self.out / "figure.png")
        written = [*runs.folders, self.out / "results.json", self.out / "figure.png"]
        if self.feeder is not None:
            saved = self.save_scenario or self.out / "scenario.toml"
            scenario.replace(split="train").to_toml(saved)  # the split is each command's to choose
            written.append(saved)
        say(console, f"wrote {', '.join(map(str, written[:-1]))} and {written[-1]}")
        if self.feeder is not None:
            say(console, f"`dcgrid check {written[-1]}` says whether it is worth learning on")
        offer(console, self.out / "figure.png", self.open, f"; `dcgrid replay {self.out}` shows its steps in a browser")


def _check_options(cfg: Run) -> None:
    """ValueError for options that nothing would heed, or a scenario file that cannot be."""
    for option in ("datacenters", "inverters", "save_scenario"):
        if cfg.feeder is None and getattr(cfg, option) is not None:
            raise ValueError(f"{option} says what stands on a feeder; give it with --feeder, or --set for a scenario")
    if cfg.save_scenario is not None and cfg.save_scenario.suffix != ".toml":
        raise ValueError(f"save_scenario is {str(cfg.save_scenario)!r}; give a file that ends in .toml")


def scenario_of(cfg: Run) -> Scenario:
    """The scenario that a command names; ValueError for one that cannot be."""
    from dcgrid_env import LinearDvfs, PrefillDecodeDvfs
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec
    from dcgrid_env.traces import TRACE_SOURCES
    from dcgrid_env.traces.by_name import recorded_trace

    chosen: dict[str, Any] = {}
    if cfg.dvfs is not None:
        chosen["datacenters.clock_law"] = PrefillDecodeDvfs() if cfg.dvfs == "prefill-decode" else LinearDvfs()
    if cfg.trace in TRACE_SOURCES:
        chosen["trace"] = cfg.trace
    elif cfg.trace is not None:
        names = [cfg.trace] if Path(cfg.trace).is_file() else [name.strip() for name in cfg.trace.split(",")]
        mixed = [name for name in names if name in TRACE_SOURCES]
        if mixed:
            raise ValueError(f"trace {cfg.trace!r}: generator {mixed[0]!r} stands alone; give one, or recordings only")
        chosen["trace"] = tuple(map(recorded_trace, names))
    changes = with_horizon(cfg.set, cfg.horizon)
    if cfg.feeder is not None:
        asked = Asked(cfg.feeder, cfg.scenario, cfg.datacenters, cfg.inverters)
        return scenario_on_feeder(asked, changes, cfg.split, chosen)
    return ScenarioSpec("ieee123" if cfg.scenario is None else cfg.scenario, changes).make(cfg.split, **chosen)


def _origin(scenario: Scenario) -> list[dict[str, Any]]:
    """Where each row of the data centres' load comes from: parameters and seed, or hash, licence and citation."""
    from dcgrid_env.engine.exogenous.trace_pool import trace_pool

    return [provenance.record() for provenance in trace_pool(scenario).provenance]


def table(scenario: Scenario, records: list[dict[str, Any]], names: list[str], cfg: Run) -> Table:
    """The controllers side by side, summed up over the episodes."""
    from dcgrid_env import metrics_in
    from dcgrid_env.baselines.benchmark.benchmark_tables import Table

    n = len(records) // len(names)
    length_s = scenario.horizon * scenario.dt_s
    title = f"{scenario.name}, {cfg.split} split, {n} episodes of {length_s:g} s, seeds from {cfg.seed}"
    rows = []
    # Those of requests and of what sites have beside clock and queue are there where the scenario has any.
    for metric in (metric for metric in metrics_in("run") if metric.name in records[0]):
        cells = []
        for name in names:
            own = [r for r in records if r["controller"] == name]
            if metric.name.startswith(("ttft", "e2e")):
                own = [r for r in own if r["requests_sampled"]] or own[:1]
            cells.append(metric.text(metric.of_episodes(r[metric.name] for r in own)))
        rows.append((metric.label, metric.unit, *cells))
    collapsed = sum(1 - r["power_flow_converged"] for r in records)
    notes = (f"{collapsed:g} episodes ended in voltage collapse and are charged for it",) if collapsed else ()
    return Table(title, ("mean over episodes", "unit", *names), tuple(rows), notes)


def linear_difference(scenario: Scenario, seeds: range) -> str:
    """How far LinDistFlow's voltages are from DistFlow's on the same episodes without control."""
    import numpy as np

    from dcgrid_env.baselines import NoControl, rollout

    runs = [rollout(scenario.replace(power_flow=flow), NoControl(), seeds) for flow in ("distflow", "lindistflow")]
    lengths = [min(len(run.lane(i).v_pu) for run in runs) for i in range(len(seeds))]
    apart = [np.abs(runs[0].lane(i).v_pu[:n] - runs[1].lane(i).v_pu[:n]) for i, n in enumerate(lengths)]
    mean, most = np.mean([a.mean() for a in apart]), np.max([a.max() for a in apart])
    return f"LinDistFlow, which leaves losses out, is off by {mean:.4f} p.u. on average and {most:.4f} at most (none)"
