"""The commands ``dcgrid traces fetch``, ``show`` and ``record``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from dcgrid_env.cli.command import GOES_ON, Command
from dcgrid_env.cli.terminal import plain_console, say, working

if TYPE_CHECKING:
    from dcgrid_env.traces import PowerTrace

SHORTEST_S = 2.0
"""Shortest trace with a spectrum, s: 20 steps of 0.1 s."""


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
        """Download, and print the licence and the citation."""
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
        say(console, f"licence: {recording.licence}\ncite:    {recording.citation}")


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
