"""CSV files of a feeder's folder, read and written: the rows with their lines, numbers, and errors that name both."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from dcgrid_env.core.user_files import parse_toml, read_text
from dcgrid_env.grid.topology import FeederError

_NEEDED = "a feeder's folder has feeder.toml and buses.csv, and branches.csv if it is balanced"


def file_text(path: Path) -> str:
    """Return the text of a file; FeederError if it cannot be read."""
    try:
        return read_text(path, FeederError)
    except FileNotFoundError:
        raise FeederError(f"{path} is missing; {_NEEDED}") from None
    except OSError as error:
        raise FeederError(f"{path} cannot be read ({error.strerror}); give a file") from None


def head_of(path: Path) -> dict[str, Any]:
    """Return the tables of feeder.toml; FeederError if it cannot be read."""
    return parse_toml(file_text(path), str(path), FeederError)


def table_rows(
    path: Path, needed: Sequence[str], optional: Sequence[str] = (), ignored: Sequence[str] = ()
) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the line number and the cells of each row, without spaces at their ends; an absent cell is empty.

    Parameters
    ----------
    path
        The file.
    needed, optional, ignored
        Columns that the file must have, may have, and may have without a meaning here.

    Raises
    ------
    FeederError
        For a file that cannot be read, a missing, unknown or repeated column, and cells beyond the last column.
    """
    reader = csv.DictReader(file_text(path).splitlines(), restkey="", restval="")
    header, known = list(reader.fieldnames or []), (*needed, *optional)
    for column in needed:
        if column not in header:
            raise FeederError(f"{path}: the column {column!r} is missing; the file has {header}")
    for k, column in enumerate(header):
        if column not in (*known, *ignored):
            raise FeederError(f"{path}: the column {column!r} is unknown; the columns are {', '.join(known)}")
        if column in header[:k]:
            raise FeederError(f"{path}: the column {column!r} is there twice; leave one out")
    for row in reader:
        if "" in row:
            raise FeederError(f"{path}, line {reader.line_num}: {row['']} is beyond the last column; leave it out")
        yield reader.line_num, {column: cell.strip() for column, cell in row.items()}


def cell_number(path: Path, line: int, column: str, text: str, if_empty: float | None = None) -> float:
    """Return the number in a cell; FeederError unless it is finite. None for ``if_empty`` refuses an empty cell."""
    if not text and if_empty is not None:
        return if_empty
    try:
        value = float(text)
    except ValueError:
        raise FeederError(f"{path}, line {line}: {column} is {text!r}; give a number") from None
    if not math.isfinite(value):
        raise FeederError(f"{path}, line {line}: {column} is {text!r}; give a finite number")
    return value


def table_text(header: Sequence[str], rows: Iterable[Sequence[Any]], may_be_empty: Sequence[bool] = ()) -> str:
    """Return the text of a CSV file that ``table_rows`` reads back to the bit; NaN is an empty cell.

    Raises
    ------
    FeederError
        For a text with spaces at its ends, with a line end, or empty in a column that ``may_be_empty`` does not name.
    """
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        for cell, may_be in zip(row, may_be_empty or [False] * len(header), strict=True):
            lines = cell.splitlines() or [cell] * may_be if isinstance(cell, str) else [cell]
            if isinstance(cell, str) and (cell != cell.strip() or len(lines) != 1):
                raise FeederError(f"{cell!r} cannot be written; leave out spaces at its ends and line ends")
        writer.writerow([cell if isinstance(cell, str) else _figure(cell) for cell in row])
    return written.getvalue()


def _figure(value: float) -> str:
    if isinstance(value, int):
        return str(value)
    return "" if math.isnan(value) else repr(float(value))
