"""Power logs of ``dcgmi dmon -e 155``, the text output of NVIDIA's Data Center GPU Manager."""

from __future__ import annotations

import os
import re

from dcgrid_env.traces.checks import TraceError, require_positive
from dcgrid_env.traces.logs.meters import Meters
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.recording_clock import BEGAN
from dcgrid_env.traces.text.cells import not_a_number, reading
from dcgrid_env.traces.text.dates import seconds
from dcgrid_env.traces.text.text_file import open_text, stem
from dcgrid_env.traces.text.times import clock_text
from dcgrid_env.traces.trace import PowerTrace

COMMAND = "dcgmi dmon -e 155 -d 1000 | ts '%Y-%m-%dT%H:%M:%.S'"
POWER = "POWER"
"""Short name of the field 155, the power of a GPU in W."""
HEADER = re.compile(r"(?:^|\s)#\s?Entity\b\s*(?P<fields>.*)$")
_UNITS = re.compile(r"(?:^|\s)I[dD]\s")
_ROW = re.compile(r"^\s*(?:(?P<time>\S+)\s+)??(?P<entity>[A-Za-z][\w-]*)\s+(?P<number>\d+)\s+(?P<values>\S.*)$")
_GPU = "GPU"


def read_dmon_log(
    path: str | os.PathLike[str],
    *,
    step_s: float | None = None,
    max_gap_s: float | None = None,
    gaps: str = "error",
    limit_kw: float | None = None,
    name: str | None = None,
) -> PowerTrace:
    """Read the power of all GPUs of a log, summed.

    A reading applies until the next one of its GPU. dcgmi writes no times. Each line begins with a time that another
    program added, or `step_s` gives the delay between the readings of a GPU. The two lines of the header may be
    repeated. `N/A` is a missing reading. Lines of other entities (instances of a GPU, switches) are skipped.

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip.
    step_s : delay of `dcgmi dmon -d`, in s; for a log whose lines do not begin with a time.
    max_gap_s, gaps : rule for readings of a GPU that are far apart, see `dcgrid_env.traces.logs.meters.Meters`.
    limit_kw : highest accepted reading, kW; 2 kW by default.
    name : name of the trace; by default the file's name without suffix.

    Raises
    ------
    TraceError
        If the field POWER is missing, a line cannot be read, times are missing, repeat or go back, or there is a gap.
        The message contains the file and the line.

    References
    ----------
    NVIDIA, DCGM documentation, "dcgmi dmon".
    """
    if step_s is not None:
        require_positive(step_s, "step_s", "give the delay of dcgmi dmon -d in seconds")
    with open_text(path) as file:
        meters = Meters(
            file.name, POWER, "W", max_gap_s=max_gap_s, gaps=gaps, limit_kw=limit_kw,
            placed=lambda gpu, line: f"{file.name}, line {line}: {gpu}",
        )  # fmt: skip
        fields: list[str] = []
        rows: dict[str, int] = {}
        for block in file.blocks():
            for number, line in block.lines():
                where = f"{file.name}, line {number}"
                header = HEADER.search(line)
                if header is not None:
                    fields = _fields(where, header["fields"])
                    continue
                row = _ROW.match(line)
                if _UNITS.search(line) and (row is None or row["entity"] in ("Id", "ID")):
                    continue
                values = row["values"].split() if row is not None else []
                if row is None or len(values) != len(fields):
                    if fields and not block.text.endswith("\n") and block.text.endswith(line):
                        continue  # the last line was cut short
                    raise TraceError(
                        f"{where}: {line.strip()[:60]!r} is not a line of `dcgmi dmon` with {len(fields)} values after "
                        "its entity; repair or remove the line, and keep the header"
                    )
                if row["entity"] != _GPU:
                    continue
                gpu = f"{_GPU} {row['number']}"
                rows[gpu] = rows.get(gpu, -1) + 1
                power = values[fields.index(POWER)]
                meters.add(gpu, _time(where, row["time"], step_s, rows[gpu]), _number(where, power), number)
        sha256 = file.sha256()
    total = meters.total()
    parameters = {"gpus": len(meters.meters), "column": POWER} | total.notes
    if step_s is None:
        parameters[BEGAN] = clock_text(total.begin_s)
    return total.trace(name or stem(path), Provenance(file.name, None, parameters, sha256))


def _fields(where: str, text: str) -> list[str]:
    fields = text.split()
    if POWER not in fields:
        raise TraceError(f"{where}: the fields {', '.join(fields) or 'none'} lack {POWER}; log with `{COMMAND}`")
    return fields


def _time(where: str, text: str | None, step_s: float | None, row: int) -> float:
    if step_s is not None:
        return row * step_s
    if text is None:
        raise TraceError(
            f"{where}: begins with no time, as dcgmi dmon prints none; log with `{COMMAND}`, or pass step_s= (the "
            "delay of -d in s)"
        )
    return seconds(text, where)


def _number(where: str, text: str) -> float:
    try:
        return reading(text)
    except ValueError:
        raise TraceError(f"{where}: {POWER} {not_a_number(text)}") from None
