"""Reading a power trace from a text file, with errors that name the line and the column."""

import csv
import os
from array import array
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from dcgrid_env.traces.trace import FloatArray, TraceError, check_samples

KW_PER_UNIT = {"W": 1e-3, "kW": 1.0, "MW": 1e3}

Column = int | str


def read_csv(
    path: str | os.PathLike[str],
    time_column: Column = 0,
    power_columns: Sequence[Column] | None = None,
    unit: str = "W",
    header: bool | None = None,
    delimiter: str = ",",
) -> tuple[FloatArray, FloatArray]:
    """Read times and the sum of the power columns.

    Parameters
    ----------
    path : text file, UTF-8; empty lines are skipped.
    time_column : index from 0 or header name; times in s.
    power_columns : indices or header names, summed; by default every column but the time (one for each GPU).
    unit : of the power columns: "W", "kW" or "MW".
    header : whether the first line holds names; by default it does if none of its cells is a number.
    delimiter : between cells.

    Returns
    -------
    time_s, power_kw : (n,) float64 each

    Raises
    ------
    TraceError
        For an empty or unreadable file, an unknown unit or column, a text cell, a missing cell, or bad samples.
    """
    path = Path(path)
    if unit not in KW_PER_UNIT:
        raise TraceError(f"{path.name}: unit {unit!r} is unknown; choose one of {', '.join(KW_PER_UNIT)}")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            fields, line, table = _read_cells(path.name, file, time_column, power_columns, header, delimiter)
    except (UnicodeDecodeError, csv.Error) as error:
        raise TraceError(f"{path.name}: is not a UTF-8 text file of cells ({error}); export it as CSV") from error
    if len(table) < 2:
        raise TraceError(f"{path.name}: has {len(table)} samples; give at least 2 (a sample holds until the next)")
    check_samples(table[:, 0], table[:, 1:], lambda i: f"{path.name}, line {line[i]}", fields[0], fields[1:])
    return table[:, 0].copy(), table[:, 1:].sum(axis=1) * KW_PER_UNIT[unit]


def _read_cells(name: str, file, time_column: Column, power_columns, header: bool | None, delimiter: str):
    """Return the chosen columns' names, the line of each sample, and the cells (n, 1 + n_power), time first."""
    reader = csv.reader(file, delimiter=delimiter)
    rows = ((reader.line_num, row) for row in reader if any(cell.strip() for cell in row))
    first = next(rows, None)
    if first is None:
        raise TraceError(f"{name}: is empty; give a file with a time column and at least one power column")
    has_header = header if header is not None else not any(_is_number(cell) for cell in first[1])
    width = len(first[1])
    names = [cell.strip() for cell in first[1]] if has_header else None
    columns = _choose(name, width, names, time_column, power_columns)
    fields = [f"column {c}" if names is None else f"column {c} ({names[c]!r})" for c in columns]

    line, cells = array("q"), array("d")
    for number, row in rows if has_header else chain([first], rows):
        if len(row) != width:
            raise TraceError(f"{name}, line {number}: has {len(row)} cells, the first line {width}; repair the line")
        for c, field in zip(columns, fields, strict=True):
            try:
                cells.append(float(row[c]))
            except ValueError:
                remedy = "pass header=True if this line holds names" if number == first[0] else "repair the cell"
                raise TraceError(f"{name}, line {number}: {field} is {row[c]!r}, not a number; {remedy}") from None
        line.append(number)
    return fields, line, np.array(cells, dtype=np.float64).reshape(-1, len(columns))


def _choose(name: str, width: int, names: list[str] | None, time_column: Column, power_columns) -> list[int]:
    """Indices of the chosen columns, the time first."""
    if width < 2:
        raise TraceError(
            f"{name}: has {width} column; a time and at least one power column are needed "
            "(pass delimiter= if the cells are not separated by commas)"
        )
    time = _index(name, width, names, time_column)
    if power_columns is None:
        return [time, *(c for c in range(width) if c != time)]
    if isinstance(power_columns, str) or not power_columns:
        raise TraceError(
            f"{name}: power_columns is {power_columns!r}; give a list of indices or names, or None for all"
        )
    columns = [time, *(_index(name, width, names, c) for c in power_columns)]
    if len(set(columns)) < len(columns):
        raise TraceError(f"{name}: a column stands twice in time {time_column!r} and power {list(power_columns)!r}")
    return columns


def _index(name: str, width: int, names: list[str] | None, column: Column) -> int:
    """Index of a column given by index or by header name."""
    if isinstance(column, str):
        if names is None:
            raise TraceError(f"{name}: column {column!r} is asked for by name, but there is no header; give an index")
        if names.count(column) != 1:
            fault = "unknown" if column not in names else "not unique"
            raise TraceError(f"{name}: column {column!r} is {fault}; the header holds {', '.join(names)}")
        return names.index(column)
    if not 0 <= column < width:
        raise TraceError(f"{name}: column {column} is unknown; columns are 0 to {width - 1}")
    return int(column)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
