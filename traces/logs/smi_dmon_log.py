"""Power logs of ``nvidia-smi dmon -s p -o DT``, a text output of NVIDIA's driver."""

from __future__ import annotations

import os
import re

from dcgrid_env.traces.checks import TraceError, require_positive
from dcgrid_env.traces.logs.meters import Meters
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.text.cells import not_a_number, reading
from dcgrid_env.traces.text.dates import seconds
from dcgrid_env.traces.text.text_file import open_text, stem
from dcgrid_env.traces.text.times import clock_text
from dcgrid_env.traces.trace import PowerTrace

COMMAND = "nvidia-smi dmon -s p -o DT"
POWER = "pwr"
HEADER = re.compile(r"(?P<time>\S+[\s,]+)?#\s*(?P<fields>(?:Date[\s,]+)?(?:Time[\s,]+)?gpu\b.*)")
_BETWEEN = re.compile(r"[\s,]+")


def read_smi_dmon_log(
    path: str | os.PathLike[str],
    *,
    step_s: float | None = None,
    max_gap_s: float | None = None,
    gaps: str = "error",
    limit_kw: float | None = None,
    name: str | None = None,
) -> PowerTrace:
    """Read the power of all GPUs of a log, summed.

    A reading applies until the next one of its GPU. The times are the columns Date and Time (`-o DT`), or a text that
    another program put in front of each line, or `step_s` gives the delay between the readings of a GPU. The lines of
    the header may be repeated. `-` is a missing reading.

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip; cells are separated by spaces or commas.
    step_s : delay of `nvidia-smi dmon -d`, in s; for a log without dates.
    max_gap_s, gaps : rule for readings of a GPU that are far apart, see `dcgrid_env.traces.logs.meters.Meters`.
    limit_kw : highest accepted reading, kW; 2 kW by default.
    name : name of the trace; by default the file's name without suffix.

    Raises
    ------
    TraceError
        If the column pwr is missing, a line cannot be read, times are missing, repeat or go back, or there is a gap.
        The message contains the file and the line.

    References
    ----------
    NVIDIA, manual page of nvidia-smi, "Device Monitoring".
    """
    if step_s is not None:
        require_positive(step_s, "step_s", "give the delay of nvidia-smi dmon -d in seconds")
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
                header = HEADER.match(line.strip())
                if header is not None:
                    fields = _fields(where, header["fields"])
                    continue
                if "#" in line:
                    continue  # the units, or a comment
                cells = _BETWEEN.split(line.strip())
                if not fields or len(cells) - len(fields) not in (0, 1):
                    if fields and not block.text.endswith("\n") and block.text.endswith(line):
                        continue  # the last line was cut short
                    raise TraceError(
                        f"{where}: {line.strip()[:60]!r} is not a line of `{COMMAND}` with {len(fields)} cells; repair "
                        "or remove the line, and keep the header"
                    )
                before, row = cells[: -len(fields)], dict(zip(fields, cells[-len(fields) :], strict=True))
                gpu = f"GPU {row['gpu']}"
                rows[gpu] = rows.get(gpu, -1) + 1
                time_s = _time_s(where, before, row) if step_s is None else rows[gpu] * step_s
                try:
                    watt = reading(row[POWER])
                except ValueError:
                    raise TraceError(f"{where}: {POWER} {not_a_number(row[POWER])}") from None
                meters.add(gpu, time_s, watt, number)
        sha256 = file.sha256()
    total = meters.total()
    parameters = {"gpus": len(meters.meters), "column": POWER} | total.notes
    if step_s is None:
        parameters["began"] = clock_text(total.begin_s)
    return total.trace(name or stem(path), Provenance(file.name, None, parameters, sha256))


def _fields(where: str, text: str) -> list[str]:
    fields = _BETWEEN.split(text.strip())
    if POWER not in fields:
        raise TraceError(f"{where}: the columns {', '.join(fields)} lack {POWER}; log with `{COMMAND}`")
    return fields


def _time_s(where: str, before: list[str], row: dict[str, str]) -> float:
    if "Date" in row and "Time" in row:
        day = row["Date"]
        return seconds(f"{day[:4]}-{day[4:6]}-{day[6:]} {row['Time']}", where)
    if before:
        return seconds(before[0], where)
    raise TraceError(f"{where}: has no date; log with `{COMMAND}`, or pass step_s= (the delay of -d in s)")
