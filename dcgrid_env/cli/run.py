"""The command ``dcgrid run``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from dcgrid_env.baselines.runs import Runs
from dcgrid_env.cli.own_feeder import FeederRequest, chosen_line, scenario_on_feeder
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.opening import offer
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import Overrides, check_folder, with_horizon
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.files import write_json
from dcgrid_env.core.versions import meta

if TYPE_CHECKING:
    from dcgrid_env import Scenario
    from dcgrid_env.core.text_table import Table

DEFAULT_SCENARIO = "ieee33-weak"
POLICY = "analytic"
"""Bundled policy that the command compares by default."""


@dataclass(frozen=True)
class Run(Command):
    """Run controllers on the same episodes and compare them.

    Print a table of metrics, and write results.json and a figure of the first episode.
    """

    scenario: str | None = None
    """Scenario: a name (see dcgrid list), path/to/file.toml, or path/to/file.py:function or package.module:function
    that makes one. Default: ieee33-weak, or a new scenario if --feeder is given."""
    feeder: str | None = None
    """Feeder: the name of a bundled one, or a folder, for example one that dcgrid import wrote. Settings that
    --datacenters and --inverters leave open are chosen to suit its load. The source voltage is that of the feeder's
    file; --set source_voltage_pu=centred chooses one that centres the voltages. The result is printed and written as
    TOML; --set changes any field. With --scenario, the devices of that scenario are placed on this feeder."""
    datacenters: str | None = None
    """Data centres on --feeder: COUNT x SIZE kW or MW, then their buses: drawn in each episode (default), at ends, or
    at BUS,BUS. Join groups of different size by +, or give none. Example: '3 x 1 MW at ends'."""
    inverters: str | None = None
    """Inverters on --feeder: COUNT x SIZE kvar, Mvar, kVA or MVA, then their buses: spread over the load buses
    (default), at ends, or at BUS,BUS; or none. Example: '5 x 200 kvar'."""
    save_scenario: Path | None = None
    """File for the scenario on --feeder. Default: scenario.toml in the folder of --out."""
    set: Overrides = ()
    """Scenario fields to override, for example --set horizon=60 sensing.noise_pu=0.005."""
    horizon: int | None = None
    """Steps per episode, the same as --set horizon=N. With steps of 1 s, 86400 is a day."""
    controllers: str | None = None
    """Controllers, separated by commas: names (see dcgrid list), module:Class or file.py:Class (in quotes with
    arguments: 'file.py:Class(gain=0.5)'), folders of training runs, or policy files (.safetensors). The prefix guarded:
    keeps a policy near the tuned droop. A path must not contain a comma. Default: none, droop and the bundled policy
    analytic. If the scenario has no such policy: peak-shaving with storages, else inverters."""
    episodes: int = 8
    """Number of episodes per controller, with seeds --seed, --seed + 1 and so on."""
    seed: int = 0
    """Seed of the first episode."""
    split: str | None = None
    """Split that the seeds refer to: train, validation, test, ood (another GPU or service), or whole (all of load
    profiles and recordings). Default: whole for a scenario with load profiles or recordings, else test."""
    trace: str | None = None
    """Workload of the data centres: a generator, or recordings and files separated by commas. Default: the
    scenario's."""
    dvfs: Literal["linear", "prefill-decode", "power-cap"] | None = None
    """Clock model: linear slows all work alike; prefill-decode slows prefill and training, but hardly decode; with
    power-cap the setpoint is a power cap. Default: the scenario's."""
    tuned: Path | None = None
    """File of dcgrid tune with the gains of tuned controllers. Default: results/tuned.json if it was tuned for this
    scenario, else the bundled gains."""
    course: Literal["auto", "parquet", "none"] = "auto"
    """Whether every step is written to course/CONTROLLER/part-*.parquet in --out: auto writes episodes that do not fit
    into memory, parquet writes all, none writes nothing. Writing requires the extra parquet."""
    allow: str = ""
    """unverified: go on with an imported feeder whose voltages are not those of the program that it comes from."""
    out: Path = Path("results/run")
    """Folder for results.json, figure.png and, with --feeder, scenario.toml. It is created if needed."""
    open: bool = False
    """Open the figure at the end."""

    def run(self) -> None:
        """Run, print the table and write the files; check all settings first (ValueError)."""
        from dcgrid_env import scenario_hash
        from dcgrid_env.agents.policy.guard import guard_line
        from dcgrid_env.baselines import find_controller
        from dcgrid_env.baselines.engineering import file_lines
        from dcgrid_env.baselines.evaluation import episode_records
        from dcgrid_env.baselines.laws import stability
        from dcgrid_env.baselines.registry import tuned_from
        from dcgrid_env.baselines.scenario_spec import voltage_line
        from dcgrid_env.baselines.tuning.tuned import require_tuned
        from dcgrid_env.grid import AnyFeeder, is_bundled
        from dcgrid_env.scenario.site_recordings import scaled_recordings, scaling_lines

        _check_options(self)
        check_folder(self.out)
        require_tuned(self.tuned)
        scenario = scenario_of(self)
        names = controller_names(self, scenario)
        controllers = {name: find_controller(name, scenario, self.tuned) for name in names}
        if not controllers:
            raise ValueError(f"controllers: must name at least one, got {self.controllers!r}; see dcgrid list")
        seeds = range(self.seed, self.seed + self.episodes)
        console = plain_console()
        runs = Runs(scenario, seeds, self.course, self.out, console)
        with progress_bar(console) as progress:
            for name, controller in controllers.items():
                task = progress.add_task(name, total=scenario.horizon)
                runs.add(name, controller, lambda task=task: progress.advance(task))
        if self.feeder is not None or (isinstance(scenario.feeder, AnyFeeder) and not is_bundled(scenario.feeder)):
            say(console, voltage_line(scenario, self.set, self.scenario))
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
        from dcgrid_env import Feeder

        looped = isinstance(scenario.feeder, Feeder) and scenario.feeder.n_loop  # which LinDistFlow does not solve
        if scenario.power_flow == "distflow" and not looped and not runs.in_parts:  # which would run two long ones more
            console.print(linear_difference(scenario, seeds))
        for line in (*file_lines(scenario), *scaling_lines(scenario), *tuned_from(names, scenario, self.tuned)):
            console.print(line)
        for name, controller in controllers.items():
            if said := stability.warning(scenario.member(self.seed), controller):
                console.print(f"{name}: {said}")
            if line := guard_line(name, runs.metrics[name][0]):
                console.print(f"{line} (first episode)")
        about = meta() | {"split": scenario.split, "scenario_hash": scenario_hash(scenario), "trace": _origin(scenario)}
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
            say(console, f"run `dcgrid check {written[-1]}` to see whether control can gain anything there")
        offer(console, self.out / "figure.png", self.open, f"; `dcgrid replay {self.out}` shows its steps in a browser")


def _check_options(cfg: Run) -> None:
    """Raise ValueError for options that would be ignored, or an invalid scenario file."""
    for option in ("datacenters", "inverters", "save_scenario"):
        if cfg.feeder is None and getattr(cfg, option) is not None:
            raise ValueError(f"{option}: requires --feeder; to change a scenario's devices, use --set")
    if cfg.save_scenario is not None and cfg.save_scenario.suffix != ".toml":
        raise ValueError(f"save_scenario: must end in .toml, got {str(cfg.save_scenario)!r}")


def controller_names(cfg: Run, scenario: Scenario) -> list[str]:
    """Return the names of the controllers that a command compares."""
    from dcgrid_env.baselines import find_controller
    from dcgrid_env.baselines.laws.peak_shaving import has_storages

    if cfg.controllers is not None:
        return split_names(cfg.controllers)
    try:
        find_controller(POLICY, scenario)
    except ValueError:  # no policy was trained for the scenario
        return ["none", "droop", "peak-shaving" if has_storages(scenario) else "inverters"]
    return ["none", "droop", POLICY]


def scenario_of(cfg: Run) -> Scenario:
    """Make the scenario that a command names; raise ValueError if it is invalid."""
    from dcgrid_env.baselines.engineering import engineering_scenario
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec
    from dcgrid_env.traces import TRACE_SOURCES
    from dcgrid_env.traces.by_name import recorded_trace

    chosen: dict[str, Any] = {}
    if cfg.dvfs is not None:
        chosen["datacenters.clock_law"] = cfg.dvfs
    if cfg.trace in TRACE_SOURCES:
        chosen["trace"] = cfg.trace
    elif cfg.trace is not None:
        names = [cfg.trace] if Path(cfg.trace).is_file() else [name.strip() for name in cfg.trace.split(",")]
        mixed = [name for name in names if name in TRACE_SOURCES]
        if mixed:
            raise ValueError(
                f"trace: generator {mixed[0]!r} cannot be combined, got {cfg.trace!r}; give one generator, or files"
            )
        chosen["trace"] = tuple(map(recorded_trace, names))
    changes = with_horizon(cfg.set, cfg.horizon)

    def make(split: str) -> Scenario:
        if cfg.feeder is not None:
            request = FeederRequest(cfg.feeder, cfg.scenario, cfg.datacenters, cfg.inverters)
            return scenario_on_feeder(request, changes, split, chosen)
        return ScenarioSpec(DEFAULT_SCENARIO if cfg.scenario is None else cfg.scenario, changes).make(split, **chosen)

    return engineering_scenario(make) if cfg.split is None else make(cfg.split)


def _origin(scenario: Scenario) -> list[dict[str, Any]]:
    """Return the origin of each row of the workload: parameters and seed, or hash, licence and citation."""
    from dcgrid_env.engine.exogenous.trace_pool import trace_pool

    return [provenance.record() for provenance in trace_pool(scenario).provenance]


def table(scenario: Scenario, records: list[dict[str, Any]], names: list[str], cfg: Run) -> Table:
    """Return the table of metrics, one column per controller, over all episodes."""
    from dcgrid_env import metrics_in
    from dcgrid_env.core.text_table import Table

    n = len(records) // len(names)
    length_s = scenario.horizon * scenario.dt_s
    title = f"{scenario.name}, {scenario.split} split, {n} episodes of {length_s:g} s, seeds from {cfg.seed}"
    rows = []
    # Metrics of requests and of optional devices exist only in scenarios that have these.
    for metric in (metric for metric in metrics_in("run") if metric.name in records[0]):
        cells = []
        for name in names:
            episodes = [record for record in records if record["controller"] == name]
            if metric.name.startswith(("ttft", "e2e")):
                episodes = [record for record in episodes if record["requests_sampled"]] or episodes[:1]
            cells.append(metric.text(metric.of_episodes(record[metric.name] for record in episodes)))
        rows.append((metric.label, metric.unit, *cells))
    collapsed = sum(1 - r["power_flow_converged"] for r in records)
    notes = (f"{collapsed:g} episodes ended in voltage collapse; J includes the charge for it",) if collapsed else ()
    return Table(title, ("mean over episodes", "unit", *names), tuple(rows), notes)


def linear_difference(scenario: Scenario, seeds: range) -> str:
    """Return the difference between LinDistFlow's and DistFlow's voltages on the same episodes without control."""
    import numpy as np

    from dcgrid_env.baselines import NoControl, rollout

    runs = [rollout(scenario.replace(power_flow=flow), NoControl(), seeds) for flow in ("distflow", "lindistflow")]
    lengths = [min(len(run.series(i).v_pu) for run in runs) for i in range(len(seeds))]
    apart = [np.abs(runs[0].series(i).v_pu[:n] - runs[1].series(i).v_pu[:n]) for i, n in enumerate(lengths)]
    mean, most = np.mean([a.mean() for a in apart]), np.max([a.max() for a in apart])
    return (
        f"error of LinDistFlow, which neglects losses: mean {mean:.4f} p.u., largest {most:.4f} p.u. (controller none)"
    )
