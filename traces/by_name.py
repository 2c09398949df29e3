"""A trace by name: a generator, a recording in the user's cache, or a file."""

from __future__ import annotations

from pathlib import Path

from dcgrid_env.core.suggestions import unknown
from dcgrid_env.core.user_files import is_file
from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.recording_file import read_file, served
from dcgrid_env.traces.recordings import RECORDINGS, load_power, load_requests
from dcgrid_env.traces.sources import TRACE_SOURCES
from dcgrid_env.traces.trace import PowerTrace


def recorded_trace(name: str) -> PowerTrace:
    """Load a recording by name (`RECORDINGS`), or a file of any format in `recording_file.FORMATS`.

    Requests become power by being served. The trace stores the requested name (`PowerTrace.asked_by`).
    Raises TraceError if the name is neither, or the file cannot be read.
    """
    trace = _read(name)
    trace.__dict__["_asked_by"] = name if name in RECORDINGS else str(Path(name).absolute())
    return trace


def _read(name: str) -> PowerTrace:
    if name in RECORDINGS:
        if RECORDINGS[name].kind == "requests":
            return served(load_requests(name, part_s=RECORDINGS[name].part_s))
        return load_power(name)
    path = Path(name)
    if not is_file(path, TraceError):
        raise TraceError(
            unknown("trace", name, (*TRACE_SOURCES, *RECORDINGS), "`dcgrid list traces` lists all; or give a file")
        )
    return read_file(path)


def is_recording(value: object) -> bool:
    """Return whether a value names a recording or an existing file."""
    if isinstance(value, Path):
        return True
    try:
        return isinstance(value, str) and (value in RECORDINGS or Path(value).is_file())
    except (OSError, ValueError):  # a name too long, or with a null character
        return False
