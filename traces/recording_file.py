"""Files of recordings: which format a file has, and its reader."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.logs import dmon_log, smi_dmon_log, wattameter_log
from dcgrid_env.traces.logs.dmon_log import read_dmon_log
from dcgrid_env.traces.logs.gpu_columns import split
from dcgrid_env.traces.logs.gpu_log import read_gpu_log
from dcgrid_env.traces.logs.power_json import read_power_json
from dcgrid_env.traces.logs.request_log import is_request_log, read_request_log
from dcgrid_env.traces.logs.smi_dmon_log import read_smi_dmon_log
from dcgrid_env.traces.logs.stamped_csv import is_stamped, read_stamped_csv
from dcgrid_env.traces.logs.timestamps import TIMESTAMP
from dcgrid_env.traces.logs.wattameter_log import read_wattameter_log
from dcgrid_env.traces.serving.hardware import replica
from dcgrid_env.traces.serving.pool import serve
from dcgrid_env.traces.serving.requests import Requests
from dcgrid_env.traces.text.csv_file import RECORDED, csv_columns
from dcgrid_env.traces.text.table_file import TableFile, open_table
from dcgrid_env.traces.text.text_file import TextFile, open_text
from dcgrid_env.traces.trace import PowerTrace

LOAD = 0.35
"""Load that sets the number of replicas of Llama 3 70B on H100 which serve a request log without a site."""
_SHOWING_LINES = 5
"""Lines at the top of a file that show its format."""
_SHOWN_ITEMS = 8
"""Items of a list that are printed."""


@dataclass(frozen=True)
class FileFormat:
    """A format of files, with its reader."""

    name: str
    description: str
    read: Callable[..., PowerTrace]
    options: tuple[str, ...] = ()
    """Options of the reader that a caller may pass."""


def served(requests: Requests) -> PowerTrace:
    """Compute the draw of a site that answers requests, as a share of its rating."""
    unit = replica("H100", "llama3-70b")
    mean = [float(tokens.mean()) for tokens in (requests.context_tokens, requests.generated_tokens)]
    busy_s = unit.busy_s(*mean)
    return serve(requests, unit, math.ceil(len(requests) / requests.duration_s * busy_s / LOAD)).trace


def _served_log(path: str | Path, part_s: tuple[float, float] | None = None) -> PowerTrace:
    return served(read_request_log(path, part_s=part_s))


_TABLE = ("unit", "power_columns")
_COMMON = ("limit_kw", "max_gap_s", "gaps")
FORMATS: dict[str, FileFormat] = {
    form.name: form
    for form in (
        FileFormat("csv", "CSV with numeric times", PowerTrace.from_csv, (*_TABLE, "invalid", *_COMMON)),
        FileFormat("nvidia-smi", "log of nvidia-smi --query-gpu", read_gpu_log, ("unit", "columns", "gpus", *_COMMON)),
        FileFormat("dmon", "log of dcgmi dmon", read_dmon_log, ("step_s", *_COMMON)),
        FileFormat("smi-dmon", "log of nvidia-smi dmon", read_smi_dmon_log, ("step_s", *_COMMON)),
        FileFormat("wattameter", "log of WattAMeter", read_wattameter_log, _COMMON),
        FileFormat("stamped-csv", "CSV with dates and times", read_stamped_csv, (*_TABLE, *_COMMON)),
        FileFormat("json", "JSON of Prometheus, Redfish or ML.ENERGY", read_power_json, ("unit", "metric", *_COMMON)),
        FileFormat("requests", "log of requests, served by H100 with Llama 3 70B", _served_log, ("part_s",)),
    )
}
"""Formats of files by name."""


def file_format(path: str | Path) -> FileFormat:
    """Return the format of a file, which its first lines show; CSV if they show none."""
    with open_text(path) as file:
        shown = _shown(file)
    first = shown[0] if shown else ""
    if first.startswith(RECORDED):
        return FORMATS["csv"]
    if any(dmon_log.HEADER.search(line) for line in shown):
        return FORMATS["dmon"]
    if any(smi_dmon_log.HEADER.match(line.strip()) for line in shown):
        return FORMATS["smi-dmon"]
    if wattameter_log.HEADER.match(first):
        return FORMATS["wattameter"]
    with open_text(path) as file:
        first = next(iter(_shown(file, comments=False)), "")
    if first.lstrip().startswith(("{", "[")):
        return FORMATS["requests" if is_request_log(first) else "json"]
    with open_table(path) as file:
        content = _shown(file, comments=False)
    first = content[0] if content else ""
    if is_request_log(first):
        return FORMATS["requests"]
    if "power.draw" in first.lower() or any(re.fullmatch(TIMESTAMP, cell) for cell in split(first)):
        return FORMATS["nvidia-smi"]
    if len(content) > 1:
        header, cells = (next(csv.reader([line])) for line in content[:2])
        if is_stamped(header, cells):
            return FORMATS["stamped-csv"]
    return FORMATS["csv"]


def columns_line(path: str | Path, trace: PowerTrace, **options: Any) -> str:
    """Return the format of a file and what was read from it, as text."""
    form = file_format(path)
    if form.name == "csv":
        chosen = {name: options[name] for name in ("power_columns", "unit") if options.get(name) is not None}
        read = ", ".join(f"{column} in {unit}" for column, unit in csv_columns(path, **chosen).items())
        read += f"; began {trace.began}" if trace.began else ""
        dropped = trace.provenance.parameters.get("dropped", {})
        read += "".join(f"; {count} samples dropped ({fault})" for fault, count in dropped.items())
    else:
        read = ", ".join(
            f"{name} {_text(value)}" for name, value in trace.provenance.parameters.items() if name != "served_by"
        )
    return f"{form.description}; {read or 'whole log'}"


def read_file(path: str | Path, **options: Any) -> PowerTrace:
    """Read a file in the format that it shows.

    Parameters
    ----------
    path : the file.
    options : options of its reader; those that are None are left to the reader.

    Raises
    ------
    TraceError
        For an option that the format does not have, and what its reader raises.
    """
    form = file_format(path)
    passed = {name: value for name, value in options.items() if value is not None}
    for name in passed:
        if name not in form.options:
            known = ", ".join(f"{option}=" for option in form.options)
            raise TraceError(f"{Path(path).name}: a {form.description} has no option {name}=; it has {known}")
    return form.read(path, **passed)


def _text(value: Any) -> str:
    """Return a noted value as text: a few of its items if there are many."""
    if isinstance(value, dict):
        value = [f"{name} by {figure:g}" for name, figure in value.items()]
    if isinstance(value, list):
        more = f" and {len(value) - _SHOWN_ITEMS} more" if len(value) > _SHOWN_ITEMS else ""
        return f"[{', '.join(map(str, value[:_SHOWN_ITEMS]))}{more}]"
    return str(value)


def _shown(file: TextFile | TableFile, comments: bool = True) -> list[str]:
    """Return the first lines that are not empty."""
    lines = (line for line in iter(file.readline, "") if line.strip() and (comments or not line.startswith("#")))
    return [line for _, line in zip(range(_SHOWING_LINES), lines, strict=False)]
