"""The file ``ratings.csv`` of a feeder's folder, balanced or three-phase: ratings by season and for emergencies."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

from dcgrid_env.grid.formats.feeder_tables import cell_number, table_rows, table_text
from dcgrid_env.grid.network import RatingTable
from dcgrid_env.grid.topology import FeederError

RATINGS_FILE = "ratings.csv"
_COLUMNS = tuple(field.name for field in dataclasses.fields(RatingTable))


def read_ratings(folder: Path) -> RatingTable:
    """Read the ratings of a folder, no rows without the file; FeederError naming the line for an invalid cell."""
    path = folder / RATINGS_FILE
    if not path.exists():
        return RatingTable()
    rows = []
    for line, cells in table_rows(path, _COLUMNS):
        if not cells["element"]:
            raise FeederError(f"{path}, line {line}: element is empty; give a kind and name")
        figures = [cell_number(path, line, column, cells[column], math.nan) for column in ("normal", "emergency")]
        rows.append((cells["element"], cells["season"], *figures))
    return RatingTable(*zip(*rows, strict=True)) if rows else RatingTable()


def ratings_text(table: RatingTable) -> str:
    """Text of the file that ``read_ratings`` reads back to the bit."""
    rows = zip(*(getattr(table, column) for column in _COLUMNS), strict=True)
    return table_text(_COLUMNS, rows, [column == "season" for column in _COLUMNS])
