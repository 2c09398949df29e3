"""CSV files of power readings with a time and a meter in each line, or with a date and a column for each meter.

Collectors of IPMI and Redfish readings, amd-smi and dashboards write them.
"""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.logs.meters import Meters
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.recording_clock import BEGAN, UTC_OFFSET
from dcgrid_env.traces.text.cells import is_missing, is_number, not_a_number, reading
from dcgrid_env.traces.text.dates import is_date, seconds, utc_offset_h
from dcgrid_env.traces.text.power_unit import (
    KW_PER_UNIT,
    bracketed,
    column_unit,
    last_word,
    other_quantity,
    require_power,
    require_summable,
    require_unit,
    word_unit,
)
from dcgrid_env.traces.text.table_file import TableFile, open_table
from dcgrid_env.traces.text.text_file import stem
from dcgrid_env.traces.text.times import Clock, clock_of, clock_text, epoch_unit, is_time_name
from dcgrid_env.traces.trace import PowerTrace

_METERS = frozenset(
    (
        "gpu", "gpu_id", "gpu_index", "gpu_uuid", "gpu_serial", "gpu_bus_id", "pci_bus_id", "bdf", "card", "socket",
        "index", "id", "uuid", "device", "device_id", "dev", "node", "node_id", "host", "hostname", "instance",
        "server", "machine", "sensor", "sensor_id", "chassis", "rack", "pdu", "outlet", "psu", "meter", "meter_id",
        "serial", "name",
    )
)  # fmt: skip
"""Names of columns that identify a meter, in small letters with `_` between words."""
_STATES = re.compile(r"state|status|reason|mode|type|version|driver|unit|comment|note|message|job|run_id|project")
"""Words in the names of text columns that describe a reading and identify no meter."""
_QUANTITY = re.compile(r"(?P<number>[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)\s*(?P<unit>[A-Za-z%\u00b0/]+)?")
_OF_DAY = re.compile(r"\d{1,2}:\d\d(?::\d\d(?:[.,]\d+)?)?")
_SHOWING_LINES = 20
"""Lines below the header whose cells show what a column contains."""


class _Columns(NamedTuple):
    """Columns of a file by index."""

    time: int
    power: dict[int, str | None]
    """Unit of each column of power; None if each cell contains it."""
    labels: list[int]
    """Columns that identify the meter."""


def read_stamped_csv(
    path: str | os.PathLike[str],
    *,
    power_columns: Sequence[str] | None = None,
    unit: str | None = None,
    max_gap_s: float | None = None,
    gaps: str = "error",
    limit_kw: float | None = None,
    name: str | None = None,
) -> PowerTrace:
    """Read the sum of all meters of a file with one reading a line, or with one column for each meter.

    The column of times is the first one that contains a date and time, or else a number since 1970. Columns such as
    node, gpu and sensor identify the meter, and so do other columns of text. Columns of other quantities are left out.
    A reading applies until the next one of its meter.

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip, with a header, for example `timestamp,node,power_w`.
    power_columns : header names, summed; by default every column whose name or cells contain a unit of power. If none
        does and `unit` is given, every column of numbers.
    unit : unit of columns whose names contain none: "W", "kW", "MW" or "mW".
    max_gap_s, gaps : rule for readings of a meter that are far apart, see `dcgrid_env.traces.logs.meters.Meters`.
    limit_kw : highest accepted reading, kW; by default 2 kW for a GPU or processor, and 1 GW for others, whose outliers
        are refused too.
    name : name of the trace; by default the file's name without suffix.

    Raises
    ------
    TraceError
        For a file without a column of times or power, a cell that cannot be read, times of a meter that repeat or go
        back, and a gap. The message contains the file, the line and the column.
    """
    with open_table(path) as file:
        require_unit(file.name, unit)
        header, top = _top(file)
        first = top[0][1]
        where = f"{file.name}, line {top[0][0]}"
        if len(first) != len(header):
            raise TraceError(f"{where}: has {len(first)} cells, the header {len(header)}; repair the line")
        shown = [
            next((row[c] for _, row in top if len(row) == len(header) and not is_missing(row[c])), "")
            for c in range(len(header))
        ]
        columns = _columns(file.name, where, header, shown, power_columns, unit)
        meters = Meters(
            file.name, "power", "kW", max_gap_s=max_gap_s, gaps=gaps, limit_kw=limit_kw,
            placed=lambda meter, line: f"{file.name}, line {line}: {meter}",
        )  # fmt: skip
        clock, begin, time_name = None, first[columns.time], header[columns.time]
        if is_number(begin):
            clock = clock_of(float(begin), f"{where}: column {time_name!r}", time_name)
        for number, row in chain(top, _rows(file)):
            where = f"{file.name}, line {number}"
            if len(row) != len(header):
                raise TraceError(f"{where}: has {len(row)} cells, the header {len(header)}; repair the line")
            time_s = _time(row[columns.time], f"{where}: column {time_name!r}", clock)
            label = [f"{header[c]} {row[c].strip()}" for c in columns.labels]
            for column, stated in columns.power.items():
                kw = _kw(f"{where}: column {header[column]!r}", row[column], stated)
                meters.add(" ".join([*label, header[column]]), time_s, kw, number)
        sha256 = file.sha256()
    total = meters.total()
    left_out = [text for c, text in enumerate(header) if c not in (columns.time, *columns.power, *columns.labels)]
    parameters = {"meters": len(meters.meters), "columns": [header[c] for c in columns.power]} | total.notes
    parameters |= {"left_out": left_out} if left_out else {}
    if clock is None or clock.is_epoch:
        offset_h = utc_offset_h(begin) if clock is None else 0.0
        offset = {} if offset_h is None else {UTC_OFFSET: offset_h}
        parameters = {BEGAN: clock_text(total.begin_s)} | offset | parameters
    return total.trace(name or stem(path), Provenance(file.name, None, parameters, sha256))


def is_stamped(header: Sequence[str], first: Sequence[str]) -> bool:
    """Return whether the first line has a date and time, or a column for the time and one that identifies the meter."""
    if any(map(is_date, first)):
        return True
    return _time_column(header, first) is not None and any(_normalised(text) in _METERS for text in header)


def _top(file: TableFile) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Cells of the header, and number and cells of the first lines below it."""
    rows = _rows(file)
    header, top = next(rows, None), list(islice(rows, _SHOWING_LINES))
    if header is None or not top:
        raise TraceError(f"{file.name}: has no header with a reading below it; give at least 2 readings")
    return [cell.strip() for cell in header[1]], top


def _rows(file: TableFile) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each line that is neither empty nor a comment."""
    for line in iter(file.readline, ""):
        if line.strip() and not line.startswith("#"):
            yield file.line, next(csv.reader([line]))


def _normalised(header: str) -> str:
    """Return a name in small letters with `_` between its words."""
    return re.sub(r"[^a-z0-9]+", "_", header.casefold()).strip("_")


def _time_column(header: Sequence[str], first: Sequence[str]) -> int | None:
    """Return the column of times: a date and time, a number since 1970, or a number below a name of times."""
    numbers = {c: float(cell) for c, cell in enumerate(first) if is_number(cell) and c < len(header)}
    dates = (c for c, cell in enumerate(first) if is_date(cell))
    since_1970 = (c for c, number in numbers.items() if epoch_unit(number))
    named = (c for c in numbers if is_time_name(header[c]))
    return next(chain(dates, since_1970, named), None)


def _columns(
    name: str, where: str, header: list[str], first: list[str], power_columns: Sequence[str] | None, unit: str | None
) -> _Columns:
    time = _time_column(header, first)
    if time is None:
        raise TraceError(f"{where}: no cell is a date and time; give times like 2026-01-02T03:04:05Z")
    others = [c for c in range(len(header)) if c != time]
    clock = next((c for c in others if _OF_DAY.fullmatch(first[c].strip())), None)
    if clock is not None and ":" not in first[time]:
        raise TraceError(
            f"{where}: {header[time]!r} contains dates and {header[clock]!r} times; write both into one column, like "
            "2026-01-02 03:04:05"
        )
    meters = [c for c in others if _normalised(header[c]) in _METERS]
    power = _power(f"{name}, header", header, first, [c for c in others if c not in meters], power_columns, unit)
    texts = [c for c in others if c not in meters and c not in power and _is_label(header[c], first[c])]
    return _Columns(time, power, sorted([*(c for c in meters if c not in power), *texts]))


def _is_label(header: str, cell: str) -> bool:
    is_text = not is_missing(cell) and _QUANTITY.fullmatch(cell.strip()) is None
    return is_text and _STATES.search(_normalised(header)) is None


def _power(
    where: str, header: list[str], first: list[str], others: list[int], power_columns: Sequence[str] | None,
    unit: str | None,
) -> dict[int, str | None]:  # fmt: skip
    """Index and unit of each column of power; None for the unit if each cell contains it."""
    if power_columns is not None:
        missing = [text for text in power_columns if text not in header]
        if missing:
            raise TraceError(f"{where}: {', '.join(header)} has no column {missing[0]!r}; correct power_columns=")
        for text in power_columns:
            require_power(where, text, "leave it out of power_columns=, or rename it if it is power")
        chosen = [header.index(text) for text in power_columns]
        units = {c: column_unit(where, header[c], unit) for c in chosen}
    else:
        candidates = [c for c in others if header[c] and other_quantity(header[c]) is None]
        names_power = [c for c in candidates if _names_power(header[c])]
        cells_power = [c for c in candidates if _unit_in(first[c])]
        units = {c: column_unit(where, header[c], unit) for c in names_power}
        units |= {c: unit for c in cells_power if c not in units}
        if not units and unit is not None:
            numbers = [c for c in candidates if is_number(first[c])]
            units = {c: unit for c in numbers if not bracketed(header[c])[1]}
        if not any(is_number(first[c]) for c in candidates):
            for c in () if units else others:
                require_power(where, header[c], "give a column of power, or rename it if it is power")
                other = other_quantity(header[c])
                if other is not None and _names_power(header[c]):
                    raise TraceError(f"{where}: {header[c]!r} names {other!r}; pass power_columns= if it is power")
    lacking = next((c for c, stated in units.items() if stated is None and not _unit_in(first[c])), None)
    if lacking is not None or not units:
        fault = ", ".join(header) if lacking is None else repr(header[lacking])
        remedy = " and, if other columns are no power, power_columns=" if power_columns is None else ""
        raise TraceError(
            f"{where}: {fault} names no unit of power; pass unit= (one of {', '.join(KW_PER_UNIT)}){remedy}"
        )
    if power_columns is None:
        require_summable(where, [header[c] for c in sorted(units)])
    return dict(sorted(units.items()))


def _names_power(header: str) -> bool:
    return any(word_unit(word) or word.casefold() == "mw" for word in (bracketed(header)[0], last_word(header)))


def _unit_in(cell: str) -> str | None:
    """Return the unit of power in a cell such as `300 W`."""
    match = _QUANTITY.fullmatch(cell.strip())
    return word_unit(match["unit"]) if match and match["unit"] else None


def _time(text: str, where: str, clock: Clock | None) -> float:
    if clock is None:
        return seconds(text, where)
    if not is_number(text):
        raise TraceError(f"{where}: the time is {text[:40]!r}, and the first one is a number; repair the cell")
    return float(clock.seconds(np.array([float(text)]), lambda _: where)[0])


def _kw(where: str, text: str, stated: str | None) -> float:
    """Return the power in a cell, kW; `stated` is the unit of its column."""
    match = _QUANTITY.fullmatch(text.strip())
    cell_unit = word_unit(match["unit"]) if match and match["unit"] else None
    if match and cell_unit:
        if stated not in (None, cell_unit):
            raise TraceError(f"{where} is {text.strip()[:40]!r}, but the column is in {stated}; repair the cell")
        return float(match["number"]) * KW_PER_UNIT[cell_unit]
    try:
        value = reading(text)
    except ValueError:
        raise TraceError(f"{where} {not_a_number(text)}") from None
    if stated is None and not math.isnan(value):
        raise TraceError(f"{where} is {text.strip()[:40]!r} without a unit, which the first cell has; repair the cell")
    return value * KW_PER_UNIT[stated or "kW"]
