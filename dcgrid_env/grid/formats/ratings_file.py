"""The file ``ratings.csv`` of a feeder's folder, balanced or three-phase: ratings by season and for emergencies."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from pathlib import Path

from dcgrid_env.grid.network import RatingTable
from dcgrid_env.grid.topology import FeederError

RATINGS_FILE = "ratings.csv"
_COLUMNS = tuple(field.name for field in dataclasses.fields(RatingTable))


def read_ratings(folder: Path) -> RatingTable:
    """Read the ratings of a folder, no rows without the file; FeederError naming the line for an invalid cell."""
    path = folder / RATINGS_FILE
    if not path.exists():
        return RatingTable()
    try:
        reader = csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines(), restkey="", restval="")
    except (UnicodeDecodeError, OSError) as error:
        raise FeederError(f"{path}: {error}; give a readable file in UTF-8") from None
    header = list(reader.fieldnames or [])
    if sorted(header) != sorted(_COLUMNS):
        raise FeederError(f"{path}: its columns are {header}; they must be {', '.join(_COLUMNS)}")
    rows = []
    for row in reader:
        if "" in row:
            raise FeederError(f"{path}, line {reader.line_num}: {row['']} stands beyond the last column")
        cells = {column: text.strip() for column, text in row.items()}
        if not cells["element"]:
            raise FeederError(f"{path}, line {reader.line_num}: element is empty; give a kind and name")
        for column in ("normal", "emergency"):
            try:
                value = float(cells[column] or "nan")
            except ValueError:
                raise FeederError(
                    f"{path}, line {reader.line_num}: {column} is {cells[column]!r}; give a number, or leave it empty"
                ) from None
            if cells[column] and not math.isfinite(value):
                raise FeederError(f"{path}, line {reader.line_num}: {column} is {cells[column]!r}; give a number")
            cells[column] = value
        rows.append(tuple(cells[column] for column in _COLUMNS))
    return RatingTable(*zip(*rows, strict=True)) if rows else RatingTable()


def ratings_text(table: RatingTable) -> str:
    """Text of the file that ``read_ratings`` reads back to the bit."""
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for element, season, *figures in zip(*(getattr(table, column) for column in _COLUMNS), strict=True):
        for text in (element, season):
            if text != text.strip() or len(text.splitlines()) > 1:
                raise FeederError(f"rating: {text!r} cannot be written; leave out spaces at its ends and line ends")
        writer.writerow([element, season, *("" if math.isnan(v) else repr(float(v)) for v in figures)])
    return written.getvalue()
