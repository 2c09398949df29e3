"""The commands ``dcgrid traces check``, ``fetch``, ``show`` and ``record``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from dcgrid_env.core.commands.command import GOES_ON, Command
from dcgrid_env.core.commands.settings import Overrides, check_file, with_horizon
from dcgrid_env.core.commands.terminal import plain_console, say, working

if TYPE_CHECKING:
    from dcgrid_env import Scenario
    from dcgrid_env.traces import PowerTrace

SHORTEST_S = 2.0
"""Shortest trace with a spectrum, s: 20 steps of 0.1 s."""


@dataclass(frozen=True)
class CheckRecording(Command):
    """Check a recording of power and report how it would be used.

    Prints the columns and units, sampling, gaps, constant stretches, rating, ramps, the scale and the number of
    independent windows of each split. Errors name the file, the line, the column and the value.
    """

    name: tyro.conf.Positional[str]
    """File (power, log of a meter or requests) or fetched recording (dcgrid list)."""
    rated_kw: float | None = None
    """Rating of the recorded site, kW. Default: the file's if it notes one, otherwise unknown."""
    unit: Literal["W", "kW", "MW", "mW", "share"] | None = None
    """Unit of the power columns. Default: their names contain it."""
    power_columns: tuple[str, ...] = ()
    """Names of the power columns, which are summed. Default: all."""
    columns: str | None = None
    """Columns of a log of nvidia-smi without a header, as they were queried: timestamp,index,power.draw."""
    gpus: int | None = None
    """Number of GPUs in a log of nvidia-smi without a column that identifies them. The lines of each round must be
    complete and in order."""
    metric: str | None = None
    """Metric of a JSON file with several."""
    step_s: float | None = None
    """Delay of a log of dcgmi dmon or nvidia-smi dmon without times, s."""
    part_s: tuple[float, float] | None = None
    """Begin and end of the part of a request log to read, s. Default: the whole log."""
    invalid: Literal["error", "drop"] | None = None
    """Treatment of samples that are missing, not a number or negative. Default: error."""
    gaps: Literal["error", "hold", "linear"] | None = None
    """Treatment of gaps longer than --max-gap-s: an error, hold the last sample, or a straight line. Default: error."""
    max_gap_s: float | None = None
    """Longest interval between samples that is not a gap, s. Default: any in a CSV with numeric times, five usual
    intervals but at least 15 s in other files."""
    limit_kw: float | None = None
    """Highest accepted reading of one meter or cell, kW. Default: 2 kW for a GPU or processor, 1 GW for others, whose
    outliers are refused too."""
    scenario: str = "ieee33-weak"
    """Scenario: a name (dcgrid list), path/to/file.toml, path/to/file.py:function or package.module:function."""
    set: Overrides = ()
    """Scenario fields to override, for example --set workload.trace_scale=as-recorded."""
    horizon: int | None = None
    """Steps per episode. Default: the scenario's."""
    png: Path | None = None
    """Image file with power, ramps, spectrum and duration curve."""
    out: Path | None = None
    """JSON file with the findings."""
    save: Path | None = None
    """CSV file with the recording as it was read, its rating included. Use it as the trace of a scenario."""

    def run(self) -> None:
        """Read, print the findings and write the files; raise ValueError if the scenario refuses the recording."""
        from dcgrid_env.baselines.scenario_spec import ScenarioSpec
        from dcgrid_env.core.files import write_figure, write_json
        from dcgrid_env.engine.exogenous.trace_pool import window_steps
        from dcgrid_env.scenario.site_recordings import scaling_lines
        from dcgrid_env.traces.recording_check import check_recording

        for field, path in (("png", self.png), ("out", self.out), ("save", self.save)):
            if path is not None:
                check_file(field, path)
        changes = with_horizon(self.set, self.horizon)
        console = plain_console()
        with working(console, "reading the recording"):
            trace, source = self.recording()
        # The recording's own scale may be refused, but the step and the episode are known all the same.
        unscaled = tuple(change for change in changes if change.partition("=")[0].strip() not in _SCALE)
        spec = ScenarioSpec(self.scenario, unscaled).make("train")
        report = check_recording(trace, spec.dt_s, window_steps(spec) * spec.dt_s, _idle_share(spec))
        say(console, f"{trace.name}: {trace.provenance}\nread: {source}")
        for line in report.lines():
            say(console, line)
        for line in report.warnings():
            say(console, f"warning: {line}")
        if self.png is not None:
            from dcgrid_env.traces.figure import trace_figure

            _require_spectrum(trace)
            write_figure(self.png, trace_figure({trace.name: trace}, spec.dt_s), dpi=130)
            say(console, f"wrote {self.png}")
        if self.save is not None:
            trace.to_csv(self.save)
            say(console, f"wrote {self.save}")
        scaling, refused = [], None
        try:
            scaling = scaling_lines(ScenarioSpec(self.scenario, changes).make("train", trace=(trace,)))
        except ValueError as error:
            refused = error
        for line in scaling:
            say(console, line)
        if self.out is not None:
            findings = {"source": trace.provenance.record(), "read": source, "warnings": report.warnings()}
            used = {"scenario": self.scenario, "scaling": scaling, "refused": str(refused) if refused else None}
            write_json(self.out, findings | used | report.record())
            say(console, f"wrote {self.out}")
        if refused is not None:
            raise refused

    def recording(self) -> tuple[PowerTrace, str]:
        """Read the recording; return it with a text on what was read."""
        from dcgrid_env.traces.by_name import recorded_trace
        from dcgrid_env.traces.recording_file import columns_line, read_file
        from dcgrid_env.traces.recordings import RECORDINGS

        options: dict[str, Any] = {
            "unit": self.unit, "power_columns": self.power_columns or None, "columns": self.columns, "gpus": self.gpus,
            "metric": self.metric, "step_s": self.step_s, "part_s": self.part_s, "invalid": self.invalid,
            "gaps": self.gaps, "max_gap_s": self.max_gap_s, "limit_kw": self.limit_kw,
        }  # fmt: skip
        used = [name for name, value in options.items() if value is not None]
        if self.name in RECORDINGS or not Path(self.name).is_file():
            if used:
                raise ValueError(f"{used[0]}: is an option for files, got the recording {self.name!r}; leave it out")
            trace, source = recorded_trace(self.name), "fetched recording"
        else:
            trace = read_file(self.name, **options)
            source = columns_line(self.name, trace, **options)
        return (trace if self.rated_kw is None else trace.with_site_rating(self.rated_kw)), source


@dataclass(frozen=True)
class Fetch(Command):
    """Download a published recording and verify it.

    The recording is stored in the user's cache folder. Run an interrupted command again to resume.
    """

    name: tyro.conf.Positional[str]
    """Name of the recording (dcgrid list)."""
    cache: Path | None = None
    """Cache folder. Default: $DCGRID_CACHE if set, otherwise the user's cache folder."""

    @property
    def resumes(self) -> str:
        """Message on how to resume; downloaded data is kept."""
        return GOES_ON

    def run(self) -> None:
        """Download, and print the checksum, the licence and the citation."""
        from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn

        from dcgrid_env.traces.recordings import RECORDINGS
        from dcgrid_env.traces.recordings import fetch as download

        console = plain_console()
        with Progress(
            TextColumn(self.name, markup=False), BarColumn(), DownloadColumn(), console=console, transient=True
        ) as progress:
            task = progress.add_task(self.name, total=None)
            path = download(self.name, self.cache, lambda have, size: progress.update(task, completed=have, total=size))
        recording = RECORDINGS[self.name]
        say(console, f"{path}\n{recording.description}")
        say(console, f"sha256:  {recording.sha256}\nlicence: {recording.licence}\ncite:    {recording.citation}")


@dataclass(frozen=True)
class Show(Command):
    """Plot a trace: power, ramps, spectrum and duration curve."""

    name: tyro.conf.Positional[str]
    """Trace: a generator or fetched recording (dcgrid list), or a file (power trace, nvidia-smi log or request log)."""
    against: str | None = None
    """Second trace to compare with in the same plots."""
    duration_s: float = 600.0
    """Duration of a generated trace, s. At least 2 s and at least two averaging steps."""
    seed: int = 0
    """Seed of a generated trace."""
    dt_s: float = 1.0
    """Averaging step, s. At most half of the duration."""
    out: Path = Path("results/trace.png")
    """Image file. Its folder is created if missing."""

    def run(self) -> None:
        """Draw, and print the sources of the traces."""
        from dcgrid_env.core.files import write_figure
        from dcgrid_env.traces.figure import trace_figure

        names = [self.name, *([self.against] if self.against else [])]
        traces = {name: _long_enough(name, _find(name, self), self) for name in names}
        write_figure(self.out, trace_figure(traces, self.dt_s), dpi=130)
        console = plain_console()
        for name, trace in traces.items():
            say(console, f"{name}: {trace.duration_s:g} s, {trace.provenance}")
        say(console, f"wrote {self.out}")


@dataclass(frozen=True)
class Record(Command):
    """Record the power of this machine's GPUs through NVML.

    The command changes no GPU setting. Press Ctrl-C to end the recording and keep it.
    """

    out: tyro.conf.Positional[Path]
    """Trace file to write. It is compressed if its name ends in .gz."""
    hz: float = 10.0
    """Sampling rate, Hz. At most 20."""
    duration_s: float | None = None
    """Duration, s. Default: until Ctrl-C."""
    gpus: tuple[int, ...] = ()
    """GPU indices as in nvidia-smi, for example --gpus 0 1. Default: all GPUs."""
    overwrite: bool = False
    """Replace an existing file."""

    def run(self) -> None:
        """Record, and show the current power on one line."""
        from dcgrid_env.traces.recorder import record as sample

        console = plain_console()
        with working(console, "recording, press Ctrl-C to end") as status:
            noted = sample(
                self.out,
                self.hz,
                self.duration_s,
                list(self.gpus) or None,
                progress=lambda time_s, watt: status.update(f"{time_s:.1f} s, {watt:.0f} W, press Ctrl-C to end"),
                overwrite=self.overwrite,
            )
        jitter = noted["jitter_s"]
        say(
            console,
            f"wrote {self.out}: {noted['samples']} samples of {len(noted['gpus'])} GPUs, {noted['missed']} missed, "
            f"jitter mean {1e3 * jitter['mean']:.1f} ms, 99 % {1e3 * jitter['p99']:.1f} ms",
        )


_SCALE = ("workload.trace_scale", "trace_scale")


def _idle_share(scenario: Scenario) -> float:
    """Return the idle share of the data centres of a scenario; 0 without any."""
    return getattr(getattr(scenario, "datacenters", None), "idle_share", 0.0)


def _require_spectrum(trace: PowerTrace) -> None:
    """Raise TraceError for a trace that is too short for a spectrum."""
    from dcgrid_env.traces import TraceError

    if trace.duration_s < SHORTEST_S:
        raise TraceError(
            f"png: a spectrum needs {SHORTEST_S:g} s, got {trace.duration_s:g} s; leave --png out, or record for longer"
        )


def _find(name: str, cfg: Show) -> PowerTrace:
    from dcgrid_env.traces import TRACE_SOURCES
    from dcgrid_env.traces.by_name import recorded_trace

    if name in TRACE_SOURCES:
        return TRACE_SOURCES[name].generate(cfg.duration_s, cfg.seed)
    return recorded_trace(name)


def _long_enough(name: str, trace: PowerTrace, cfg: Show) -> PowerTrace:
    """Return the trace; raise TraceError if it is too short: ramps need 2 steps, the spectrum SHORTEST_S."""
    from dcgrid_env.traces import TRACE_SOURCES, TraceError
    from dcgrid_env.traces.checks import require_positive

    needed_s = max(2 * require_positive(cfg.dt_s, "--dt-s", "give a step in seconds"), SHORTEST_S)
    if trace.duration_s >= needed_s * (1 - 1e-9):
        return trace
    remedies = [f"a longer trace (--duration-s {needed_s:g})" if name in TRACE_SOURCES else "a longer recording"]
    if 2 * cfg.dt_s > SHORTEST_S and trace.duration_s >= SHORTEST_S:
        remedies.append(f"shorter steps (--dt-s {int(trace.duration_s / 2)})")
    raise TraceError(
        f"{name}: must last at least 2 steps of --dt-s {cfg.dt_s:g} and {SHORTEST_S:g} s for the spectrum, got "
        f"{trace.duration_s:g} s; use {' or '.join(remedies)}"
    )
