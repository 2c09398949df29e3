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
"""Shortest trace whose spectrum is drawn, s: 20 steps of 0.1 s."""


@dataclass(frozen=True)
class Fetch(Command):
    """Download a published recording and verify it.

    The recording goes into the user's cache. After an interruption, the same command resumes.
    """

    name: tyro.conf.Positional[str]
    """Name of the recording (dcgrid list)."""
    cache: Path | None = None
    """Folder for it instead of the user's cache folder (or of the one that DCGRID_CACHE names)."""

    @property
    def resumes(self) -> str:
        """How to go on: what has been kept is not done again."""
        return GOES_ON

    def run(self) -> None:
        """Download and say under which licence, and what to cite."""
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
    """A generator or a fetched recording (dcgrid list), or a file: power trace, nvidia-smi log or request log."""
    against: str | None = None
    """Another one to draw over it."""
    duration_s: float = 600.0
    """Length of a generated trace, s; at least 2, and two steps of the averages."""
    seed: int = 0
    """Seed of a generated trace."""
    dt_s: float = 1.0
    """Step of the averages, s; at most half a trace."""
    out: Path = Path("results/trace.png")
    """The picture; folders are made."""

    def run(self) -> None:
        """Draw and say what was drawn."""
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

    Changes no setting. Ctrl-C ends the recording and keeps it.
    """

    out: tyro.conf.Positional[Path]
    """The trace file, compressed if its name ends in .gz."""
    hz: float = 10.0
    """Samples a second, at most 20."""
    duration_s: float | None = None
    """Length, s; by default until Ctrl-C."""
    gpus: tuple[int, ...] = ()
    """Indices as nvidia-smi shows them; by default all."""
    overwrite: bool = False
    """Replace a file that is there."""

    def run(self) -> None:
        """Record, with the power on one line as it comes."""
        from dcgrid_env.traces.recorder import record as sample

        console = plain_console()
        with working(console, "recording, Ctrl-C to end") as status:
            noted = sample(
                self.out,
                self.hz,
                self.duration_s,
                list(self.gpus) or None,
                progress=lambda time_s, watt: status.update(f"{time_s:.1f} s, {watt:.0f} W, Ctrl-C to end"),
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
    """The trace itself; TraceError if a panel would stay empty: ramps need 2 steps, the spectrum SHORTEST_S."""
    from dcgrid_env.traces import TRACE_SOURCES, TraceError
    from dcgrid_env.traces.checks import require_positive

    needed_s = max(2 * require_positive(cfg.dt_s, "--dt-s", "give a step in seconds"), SHORTEST_S)
    if trace.duration_s >= needed_s * (1 - 1e-9):
        return trace
    remedies = [f"a longer trace (--duration-s {needed_s:g})" if name in TRACE_SOURCES else "a longer recording"]
    if 2 * cfg.dt_s > SHORTEST_S and trace.duration_s >= SHORTEST_S:
        remedies.append(f"shorter steps (--dt-s {int(trace.duration_s / 2)})")
    raise TraceError(
        f"{name}: lasts {trace.duration_s:g} s, too short for the picture: it takes 2 steps of --dt-s {cfg.dt_s:g}, "
        f"and {SHORTEST_S:g} s for the spectrum; give {' or '.join(remedies)}"
    )
