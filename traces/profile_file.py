"""Files of load profiles: CSV or Parquet, in wide or long form.

Wide form, a column for each load, bus or class. ``NAME`` is active power and ``NAME.q`` reactive power; ``NAME_pload``
and ``NAME_qload``, as in SimBench's ``LoadProfile.csv``, mean the same:

    time,s701a,s701b,s701b.q
    2025-01-01T00:00,0.41,0.38,0.35

Long form, a row for each sample of each of them, with the second column named load, bus or class:

    time,load,p,q
    2025-01-01T00:00,s701a,0.41,0.35

The first column contains the times: dates (``time``, ISO 8601 or DD.MM.YYYY HH:MM), seconds (``time_s``) or hours
(``time_h``), both counted from a midnight. Dates may have UTC offsets, or be local times that skip and repeat an hour
as clocks do (``traces.summer_time``). Lines of a CSV file that begin with # are comments. The delimiter is a comma, a
semicolon or a tab, and with the latter two numbers may have decimal commas.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.files import write_text
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.core.user_files import MOST_MIB, is_file
from dcgrid_env.traces.checks import FloatArray, TraceError
from dcgrid_env.traces.profile_table import ProfileTable, checked_table
from dcgrid_env.traces.summer_time import elapsed_s
from dcgrid_env.traces.text.dates import date_of
from dcgrid_env.traces.text.table_file import open_table

REACTIVE = ".q"
"""Ending of the name of a column of reactive power."""
_SIMBENCH = {"_pload": "", "_qload": REACTIVE}
_TIMES = {"time": 0.0, "time_s": 1.0, "time_h": 3600.0}
"""Names of the first column, and what their numbers are in s; 0 for dates."""
_LONG = ("load", "bus", "class")
"""Names of the second column in long form."""
_DATES = "write it like 2025-01-31T13:45 or 31.01.2025 13:45, or name the column time_s or time_h"


class _Raw(NamedTuple):
    """Cells of a file by column, and the number of each row's line."""

    header: list[str]
    columns: list[Sequence[Any]]
    lines: Sequence[int]
    unit: str
    """Name of a row in messages."""


def read_profiles(path: str | Path) -> ProfileTable:
    """Read load profiles from a CSV or Parquet file.

    Raises
    ------
    TraceError
        For a missing file or package, or an invalid cell, time or name. The message names the file, the line, the
        column, the value and the remedy.
    """
    path = Path(path)
    name = str(path)
    if not is_file(path, TraceError):
        raise TraceError(f"{name}: there is no such file; give a CSV or Parquet file of load profiles")
    raw = _parquet(path) if path.suffix.lower() in (".parquet", ".pq") else _csv(path)
    if raw.header[0] not in _TIMES:
        raise TraceError(f"{name}: the first column is {raw.header[0]!r}; give the times in {', '.join(_TIMES)}")
    if len(raw.header) < 2:
        raise TraceError(f"{name}: it has no column besides the times; give one for each load, bus or class")
    for i, column in enumerate(raw.header):
        if column in raw.header[:i]:
            raise TraceError(f"{name}: the column {column!r} is there twice; give each column one name")
    times_s, day = _times(name, raw)
    table = _long(name, raw, times_s, day) if raw.header[1] in _LONG else _wide(name, raw, times_s, day)
    if day:
        cells = raw.columns[0]
        table = replace(table, utc_offset_h=_utc_offset_h(cells[0]), clock_changes=_clock_changes(cells, times_s))
    table.__dict__["_asked_by"] = str(path.absolute())
    return table


def write_profiles(table: ProfileTable, path: Path, comments: Sequence[str] = ()) -> None:
    """Write load profiles as a CSV file that :func:`read_profiles` reads, with comments at its beginning."""
    text = io.StringIO()
    text.writelines(f"# {comment}\n" for comment in comments)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time" if table.first_day else "time_s", *table.names])
    writer.writerows([time, *map(repr, row)] for time, row in zip(_texts(table), table.values.tolist(), strict=True))
    write_text(path, text.getvalue())


def _texts(table: ProfileTable) -> Iterator[str]:
    """Times of the samples as texts: dates if they are known, else seconds."""
    times = (table.begin_h * 3600.0 + table.step_s * np.arange(len(table.values))).tolist()
    if not table.first_day:
        return (f"{t:.12g}" for t in times)
    offset = table.utc_offset_h
    zone = None if offset is None else timezone(timedelta(hours=offset))
    midnight = datetime.fromisoformat(table.first_day).replace(tzinfo=zone)
    return ((midnight + timedelta(seconds=round(t, 6))).isoformat() for t in times)


def read_classes(path: str | Path) -> dict[str, str]:
    """Read the class of each load or bus from a CSV file with two named columns, the load or bus and its class.

    SimBench's ``Load.csv`` also works: its columns ``node`` or ``id``, and ``profile``.

    Raises
    ------
    TraceError
        For a missing file or column, or a load that is there twice.
    """
    path = Path(path)
    if not is_file(path, TraceError):
        raise TraceError(f"{path}: there is no such file; give a CSV file with the class of each load")
    raw = _csv(path)
    id_columns, class_columns = (("load", "bus", "node", "id"), ("class", "profile"))
    key = next((name for name in id_columns if name in raw.header), None)
    value = next((name for name in class_columns if name in raw.header), None)
    if key is None or value is None:
        raise TraceError(
            f"{path}: the columns are {', '.join(raw.header)}; give one of {', '.join(id_columns)} "
            f"and one of {', '.join(class_columns)}"
        )
    classes: dict[str, str] = {}
    keys, values = (raw.columns[raw.header.index(name)] for name in (key, value))
    for line, load, kind in zip(raw.lines, keys, values, strict=True):
        if classes.get(load, kind) != kind:
            raise TraceError(f"{path}, line {line}, column {key!r}: {load!r} has a second class {kind!r}; give one")
        classes[load] = kind
    return classes


def _csv(path: Path) -> _Raw:
    with open_table(path, most_mib=MOST_MIB) as file:
        numbered = [
            (i, line)
            for i, line in enumerate(iter(file.readline, ""), start=1)
            if line.strip() and not line.startswith("#")
        ]
    if len(numbered) < 2:
        raise TraceError(f"{path}: it has no header or no samples; give a header and a line for each sample")
    rows = list(csv.reader(line for _, line in numbered))
    header = [cell.strip() for cell in rows[0]]
    lines = [i for i, _ in numbered[1:]]
    for line, row in zip(lines, rows[1:], strict=True):
        if len(row) != len(header):
            raise TraceError(
                f"{path}, line {line}: it has {len(row)} cells, and the header {len(header)}; give a value for each "
                "column"
            )
    return _Raw(header, [list(map(str.strip, cells)) for cells in zip(*rows[1:], strict=True)], lines, "line")


def _parquet(path: Path) -> _Raw:
    try:
        from pyarrow import ArrowException, parquet
    except ImportError:
        raise TraceError(
            f"{path}: reading Parquet needs pyarrow, which is missing; {from_clone('parquet')}, or give a CSV file"
        ) from None
    try:
        table = parquet.read_table(path)
    except (ArrowException, OSError) as error:
        raise TraceError(f"{path}: it cannot be read as Parquet ({' '.join(str(error).split())[:200]})") from None
    names = [str(name) for name in table.column_names]
    if names and names[0] not in _TIMES and names[-1] in _TIMES:  # pandas writes its index last
        names = [names[-1], *names[:-1]]
    columns = [table.column(name).to_pylist() for name in names]
    return _Raw(names or [""], columns, range(1, table.num_rows + 1), "row")


def _times(name: str, raw: _Raw) -> tuple[FloatArray, str]:
    """Return the times, s since some midnight, (row,), and the date of the first one."""
    head, cells = raw.header[0], raw.columns[0]
    scale = _TIMES[head]

    def refuse(i: int, remedy: str) -> TraceError:
        place = f"{name}, {raw.unit} {raw.lines[i]}, column {head!r}"
        return TraceError(f"{place}: the time is {str(cells[i])[:40]!r}; {remedy}")

    if not scale:
        return _seconds(cells, refuse, raw.columns[1] if raw.header[1] in _LONG else None)
    times = _numbers(cells)
    bad = np.flatnonzero(~np.isfinite(times))
    if len(bad):
        raise refuse(int(bad[0]), "give a finite number")
    return times * scale, ""


def date_seconds(name: str, cells: Sequence[Any]) -> tuple[FloatArray, str]:
    """Return the times of dates, s since the midnight before the first one, (row,), and the date of the first one.

    Parameters
    ----------
    name
        Name of the file or table for messages.
    cells
        Dates and times as texts.

    Raises
    ------
    TraceError
        For a text that does not contain a date; the message names its row.
    """

    def refuse(i: int, remedy: str) -> TraceError:
        return TraceError(f"{name}, row {i}, column 'time': the time is {str(cells[i])[:40]!r}; {remedy}")

    return _seconds(cells, refuse)


def _seconds(
    cells: Sequence[Any], refuse: Callable[[int, str], TraceError], names: Sequence[Any] | None = None
) -> tuple[FloatArray, str]:
    """Return times and the first date as ``date_seconds`` does; ``names`` has the series of each row."""
    dates: list[datetime] = []
    for i, cell in enumerate(cells):
        try:
            dates.append(_date(cell))
        except ValueError:
            raise refuse(i, _DATES) from None
        if (dates[i].tzinfo is None) != (dates[0].tzinfo is None):
            raise refuse(i, "give a UTC offset to all times or to none")
    first = dates[0]
    midnight = first.replace(hour=0, minute=0, second=0, microsecond=0)
    if first.tzinfo is not None:
        start = midnight.astimezone(UTC)
        times = np.array([(date.astimezone(UTC) - start).total_seconds() for date in dates], np.float64)
        return times, first.date().isoformat()
    times = np.empty(len(dates))
    rows_of: dict[Any, list[int]] = {}
    for i, name in enumerate(names or [None] * len(dates)):
        rows_of.setdefault(name, []).append(i)
    for rows in rows_of.values():
        series = [dates[i] for i in rows]
        passed = elapsed_s(series, lambda k, remedy, rows=rows: refuse(rows[k], remedy))
        times[rows] = (series[0] - midnight).total_seconds() + passed
    return times, first.date().isoformat()


def _date(cell: object) -> datetime:
    return cell if isinstance(cell, datetime) else date_of(str(cell))


def _clock_changes(cells: Sequence[Any], times_s: FloatArray) -> tuple[tuple[float, float], ...]:
    """Return ``ProfileTable.clock_changes`` of dates and their times since the midnight before the first one, s."""
    dates = [_date(cell).replace(tzinfo=None) for cell in cells]
    midnight = dates[0].replace(hour=0, minute=0, second=0, microsecond=0)
    ahead_s = np.round([(date - midnight).total_seconds() for date in dates] - times_s)
    order = np.argsort(times_s, kind="stable")
    changes = order[1:][np.diff(ahead_s[order]) != 0.0].tolist()
    return tuple((float(times_s[i]) / 3600.0, float(ahead_s[i]) / 3600.0) for i in changes)


def _utc_offset_h(cell: object) -> float | None:
    offset = _date(cell).utcoffset()
    return None if offset is None else offset.total_seconds() / 3600.0


def _numbers(cells: Sequence[Any]) -> FloatArray:
    """Return cells as numbers, NaN for those that are none."""
    try:
        return np.array([np.nan if cell is None else float(cell) for cell in cells], np.float64)
    except (TypeError, ValueError):
        return np.array([_number(cell) for cell in cells], np.float64)


def _number(cell: object) -> float:
    try:
        return float(cell)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):
        return np.nan


def _column_name(column: str) -> str:
    for ending, ours in _SIMBENCH.items():
        if column.endswith(ending):
            return column.removesuffix(ending) + ours
    return column


def _wide(name: str, raw: _Raw, times_s: FloatArray, day: str) -> ProfileTable:
    values = np.column_stack([_numbers(cells) for cells in raw.columns[1:]])
    header = raw.header[1:]
    if "" in header:
        raise TraceError(f"{name}: column {header.index('') + 2} of the header has no name; give it one")
    return checked_table(
        name,
        times_s,
        [_column_name(column) for column in header],
        values,
        lambda i: f"{raw.unit} {raw.lines[i]}",
        lambda i, j: raw.columns[j + 1][i],
        day,
    )


def _long(name: str, raw: _Raw, times_s: FloatArray, day: str) -> ProfileTable:
    quantities = raw.header[2:]
    if quantities not in (["p"], ["p", "q"]):
        raise TraceError(
            f"{name}: the columns of the long form are {', '.join(raw.header)}; give time, {raw.header[1]}, p and, if "
            "known, q"
        )
    kinds = [str(cell) for cell in raw.columns[1]]
    names = list(dict.fromkeys(kinds))
    times, row_time = np.unique(times_s, return_inverse=True)
    position = {kind: i for i, kind in enumerate(names)}
    row_kind = np.array([position[kind] for kind in kinds], np.int64)
    line_of = np.full((len(times), len(names)), -1, np.int64)
    last = np.full(len(names), -np.inf)

    def place(i: int) -> str:
        return f"{name}, {raw.unit} {raw.lines[i]}"

    for i, (t, k) in enumerate(zip(row_time.tolist(), row_kind.tolist(), strict=True)):
        if times_s[i] <= last[k]:
            how = "a second sample" if line_of[t, k] >= 0 else "a sample after a later one"
            raise TraceError(
                f"{place(i)}, column {raw.header[0]!r}: {kinds[i]!r} has {how} at {raw.columns[0][i]}; sort its "
                "samples by time, one at each"
            )
        line_of[t, k], last[k] = i, times_s[i]
    missing = np.argwhere(line_of < 0)
    if len(missing):
        t, k = missing[0]
        there = int(line_of[t].max())
        raise TraceError(
            f"{place(there)}, column {raw.header[1]!r}: {names[k]!r} has no sample at {raw.columns[0][there]}, and "
            "others have; give one for each at each time"
        )
    # A row of each time, for messages; the columns are p of all, then q of all.
    columns = [_numbers(cells)[line_of] for cells in raw.columns[2:]]
    labels = [*names, *(kind + REACTIVE for kind in names)][: len(names) * len(columns)]

    def said(i: int, j: int) -> Any:
        return raw.columns[2 + j // len(names)][line_of[i, j % len(names)]]

    where: Callable[[int], str] = lambda i: f"{raw.unit} {raw.lines[line_of[i, 0]]}"  # noqa: E731
    return checked_table(name, times, labels, np.hstack(columns), where, said, day)
