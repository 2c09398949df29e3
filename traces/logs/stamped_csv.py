"""CSV files of power readings with a date and time in each line, as collectors of IPMI and Redfish readings write."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from itertools import chain

from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.logs.clock import is_date, seconds
from dcgrid_env.traces.logs.meters import Meters, clock_text
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.text.power_unit import KW_PER_UNIT, column_unit, require_unit
from dcgrid_env.traces.text.text_file import TextFile, open_text, stem
from dcgrid_env.traces.trace import PowerTrace

_MISSING = ("", "na", "n/a", "nan", "none", "null", "-")
"""Texts of a cell without a reading, in small letters."""


def read_stamped_csv(
    path: str | os.PathLike[str],
    *,
    power_columns: Sequence[str] | None = None,
    unit: str | None = None,
    max_gap_s: float | None = None,
    gaps: str = "error",
    limit_kw: float = 1e6,
    name: str | None = None,
) -> PowerTrace:
    """Read the sum of all meters of a file with one reading a line, or with one column for each meter.

    The column of times is the first one that contains a date and time. The text of the columns that are neither time
    nor power, such as node and sensor, identifies the meter. A reading applies until the next one of its meter.

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip, with a header, for example `timestamp,node,power_w`.
    power_columns : header names, summed; by default every column whose name contains a unit of power.
    unit : unit of `power_columns` whose names contain none: "W", "kW", "MW" or "mW".
    max_gap_s, gaps : rule for readings of a meter that are far apart, see `dcgrid_env.traces.logs.meters.Meters`.
    limit_kw : highest accepted reading, kW.
    name : name of the trace; by default the file's name without suffix.

    Raises
    ------
    TraceError
        For a file without a column of times or power, a cell that cannot be read, times of a meter that repeat or go
        back, and a gap. The message contains the file, the line and the column.
    """
    with open_text(path) as file:
        require_unit(file.name, unit)
        header, first = _header(file)
        where = f"{file.name}, line {file.line}"
        if len(first) != len(header):
            raise TraceError(f"{where}: has {len(first)} cells, the header {len(header)}; repair the line")
        time = next((c for c, cell in enumerate(first) if is_date(cell)), None)
        if time is None:
            raise TraceError(f"{where}: no cell is a date and time; give times like 2026-01-02T03:04:05Z")
        power = _power(file.name, header, time, power_columns, unit)
        labels = [c for c in range(len(header)) if c != time and c not in power]
        meters = Meters(
            file.name, "power", "kW", max_gap_s=max_gap_s, gaps=gaps, limit_kw=limit_kw,
            placed=lambda meter, line: f"{file.name}, line {line}: {meter}",
        )  # fmt: skip
        rows = chain([(file.line, first)], _rows(file))
        for number, row in rows:
            where = f"{file.name}, line {number}"
            if len(row) != len(header):
                raise TraceError(f"{where}: has {len(row)} cells, the header {len(header)}; repair the line")
            time_s = seconds(row[time], f"{where}: column {header[time]!r}")
            for column, kw in power.items():
                meter = " ".join([*(row[c].strip() for c in labels), header[column]])
                reading = _number(f"{where}: column {header[column]!r}", row[column])
                meters.add(meter, time_s, kw * reading, number)
        sha256 = file.sha256()
    time_s, power_kw, begin_s = meters.total()
    parameters = {
        "began": clock_text(begin_s), "meters": len(meters.meters), "columns": [header[c] for c in power],
    }  # fmt: skip
    return PowerTrace(time_s, power_kw, name or stem(path), Provenance(file.name, None, parameters, sha256))


def _header(file: TextFile) -> tuple[list[str], list[str]]:
    """Cells of the header and of the first line below it."""
    rows = _rows(file)
    header, first = next(rows, None), next(rows, None)
    if header is None or first is None:
        raise TraceError(f"{file.name}: has no header with a reading below it; give at least 2 readings")
    return [cell.strip() for cell in header[1]], first[1]


def _rows(file: TextFile):
    """Number and cells of each line that is neither empty nor a comment."""
    for line in iter(file.readline, ""):
        if line.strip() and not line.startswith("#"):
            yield file.line, next(csv.reader([line]))


def _power(
    name: str, header: list[str], time: int, power_columns: Sequence[str] | None, unit: str | None
) -> dict[int, float]:
    """Index of each column of power, and kW for 1."""
    where = f"{name}, header"
    found: dict[int, float] = {}
    for column, text in enumerate(header):
        if column == time or (power_columns is not None and text not in power_columns):
            continue
        stated = column_unit(where, text, unit if power_columns is not None else None)
        if stated is not None:
            found[column] = KW_PER_UNIT[stated]
        elif power_columns is not None:
            raise TraceError(f"{where}: {text!r} names no unit of power; pass unit= (one of {', '.join(KW_PER_UNIT)})")
    missing = [text for text in power_columns or () if text not in header]
    if missing or not found:
        fault = f"has no column {missing[0]!r}" if missing else "names no unit of power"
        raise TraceError(f"{where}: {', '.join(header)} {fault}; pass power_columns= and unit=")
    return found


def _number(where: str, text: str) -> float:
    if text.strip().casefold() in _MISSING:
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise TraceError(f"{where} is {text[:40]!r}, not a number; repair or remove the line") from None
