"""A trace by name: a generator, a recording in the user's cache, or a file."""

from __future__ import annotations

import math
import re
from pathlib import Path

from dcgrid_env.core.suggestions import unknown
from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.logs.gpu_columns import split
from dcgrid_env.traces.logs.gpu_log import read_gpu_log
from dcgrid_env.traces.logs.request_log import read_request_log
from dcgrid_env.traces.logs.timestamps import TIMESTAMP
from dcgrid_env.traces.recordings import RECORDINGS, load_power, load_requests
from dcgrid_env.traces.serving.hardware import replica
from dcgrid_env.traces.serving.pool import serve
from dcgrid_env.traces.serving.requests import Requests
from dcgrid_env.traces.sources import TRACE_SOURCES
from dcgrid_env.traces.text.csv_file import RECORDED
from dcgrid_env.traces.text.text_file import open_text
from dcgrid_env.traces.trace import PowerTrace

LOAD = 0.35
"""Load that sets the number of replicas of Llama 3 70B on H100 which serve a request log without a site."""


def recorded_trace(name: str) -> PowerTrace:
    """Load a recording by name (`RECORDINGS`), or a file: a power trace, a log of nvidia-smi, or a request log.

    Requests become power by being served (`LOAD`). The trace stores the requested name (`PowerTrace.asked_by`).
    Raises TraceError if the name is neither, or the file cannot be read.
    """
    trace = _read(name)
    trace.__dict__["_asked_by"] = name if name in RECORDINGS else str(Path(name).absolute())
    return trace


def _read(name: str) -> PowerTrace:
    if name in RECORDINGS:
        if RECORDINGS[name].kind == "power":
            return load_power(name)
        return served(load_requests(name))
    path = Path(name)
    if not path.is_file():
        raise TraceError(
            unknown("trace", name, (*TRACE_SOURCES, *RECORDINGS), "`dcgrid list traces` lists all; or give a file")
        )
    first = _first_line(path)
    if first.startswith(RECORDED):
        return PowerTrace.from_csv(path)
    if "contexttokens" in first.lower():
        return served(read_request_log(path))
    if "power.draw" in first.lower() or any(re.fullmatch(TIMESTAMP, cell) for cell in split(first)):
        return read_gpu_log(path)
    return PowerTrace.from_csv(path)


def is_recording(value: object) -> bool:
    """Return whether a value names a recording or an existing file."""
    if isinstance(value, Path):
        return True
    try:
        return isinstance(value, str) and (value in RECORDINGS or Path(value).is_file())
    except (OSError, ValueError):  # a name too long, or with a null character
        return False


def served(requests: Requests) -> PowerTrace:
    """Compute the draw of a site that answers requests, as a share of its rating."""
    unit = replica("H100", "llama3-70b")
    mean = [float(tokens.mean()) for tokens in (requests.context_tokens, requests.generated_tokens)]
    busy_s = unit.busy_s(*mean)
    return serve(requests, unit, math.ceil(len(requests) / requests.duration_s * busy_s / LOAD)).trace


def _first_line(path: Path) -> str:
    """Return the first line that is neither empty nor a comment, or a recorder's first line; "" without one."""
    with open_text(path) as file:
        lines = (line for line in iter(file.readline, "") if line.strip())
        return next((line for line in lines if line.startswith(RECORDED) or not line.startswith("#")), "")
