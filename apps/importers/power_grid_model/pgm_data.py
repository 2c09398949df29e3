"""The input data of a power-grid-model JSON file: its cells are looked at, then power-grid-model's own reader and
checks take it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.core.user_files import parse_json, read_text
from dcgrid_env.grid.topology import FeederError

_REMEDY = "give a JSON file that power-grid-model wrote"
_LARGEST = 1e18
_KEYS = ("version", "type", "is_batch", "attributes", "data")
_MAY_BE_LARGE = {"sk"}
"""Fields in which a large number means an ideal element; any finite number is read."""
_MAY_BE_INFINITE = {"i_n", "x_grounding_from", "x_grounding_to", "r_grounding_from", "r_grounding_to"}
MISSING = f"power-grid-model is missing; {from_clone('power-grid-model')}"
Data = dict[str, np.ndarray]


def input_data(path: Path, report: Report) -> tuple[Data, dict[int, str]]:
    """Return the structured arrays of a file by component, and the names of nodes by id.

    Raises FeederError for an invalid cell, naming component, row, id and field; for data that power-grid-model's
    checks refuse; and if power-grid-model is not installed.
    """
    try:
        from power_grid_model import power_grid_meta_data
        from power_grid_model.errors import PowerGridError  # pyright: ignore[reportPrivateImportUsage]
        from power_grid_model.utils import json_deserialize  # pyright: ignore[reportPrivateImportUsage]
    except ImportError:
        raise FeederError(MISSING) from None
    text = _text(path)
    known: Any = power_grid_meta_data
    dtypes = {str(getattr(kind, "value", kind)): meta.dtype for kind, meta in known["input"].items()}
    names = _Look(str(path), dtypes, report).whole(parse_json(text, str(path), FeederError, _REMEDY))
    try:
        read = json_deserialize(text)
    except (PowerGridError, ValueError, KeyError) as error:
        raise FeederError(f"{path}: power-grid-model cannot read it ({' '.join(str(error).split())[:200]})") from None
    data: Data = {str(getattr(kind, "value", kind)): np.asarray(rows) for kind, rows in read.items()}
    _validate(str(path), data)
    return data, names


def _text(path: Path) -> str:
    try:
        return read_text(path, FeederError)
    except OSError as error:
        raise FeederError(f"{path} cannot be read ({error.strerror}); give a power-grid-model JSON file") from None


class _Look:
    """A look at the cells of a file against the types of power-grid-model's components."""

    def __init__(self, file: str, dtypes: dict[str, np.dtype[Any]], report: Report) -> None:
        self.file, self.dtypes, self.report = file, dtypes, report
        self.extra: dict[tuple[str, str], int] = {}
        self.names: dict[int, str] = {}

    def whole(self, file: Any) -> dict[int, str]:
        """Look at all; the names of nodes."""
        if not isinstance(file, dict) or set(file) != set(_KEYS):
            raise FeederError(f"{self.file} is no file of power-grid-model's; it has {', '.join(_KEYS)}")
        if file["type"] != "input" or file["is_batch"] is not False:
            raise FeederError(f"{self.file}: its type is {file['type']!r}; give one scenario of type 'input'")
        data, attributes = file["data"], file["attributes"]
        if not isinstance(data, dict) or not isinstance(attributes, dict):
            raise FeederError(f"{self.file}: its data and attributes are no objects")
        for component, rows in data.items():
            if component not in self.dtypes:
                raise FeederError(f"{self.file}: {component!r} is no component; there are {', '.join(self.dtypes)}")
            if not isinstance(rows, list):
                raise FeederError(f"{self.file}: {component} is no list of rows")
            for row, cells in enumerate(rows):
                self._row(component, row, cells, attributes.get(component))
        for (component, field), count in self.extra.items():
            if not (component == "node" and field == "name"):
                self.report.add("nothing lost", component, f"{field} ({count} rows)", "no field of power-grid-model")
        return self.names

    def _row(self, component: str, row: int, cells: Any, columns: Any) -> None:
        where = f"{self.file}: {component}, row {row + 1}"
        if isinstance(cells, list):
            if not isinstance(columns, list) or len(columns) != len(cells):
                raise FeederError(f"{where}: it has not one cell for each of its attributes")
            cells = dict(zip(map(str, columns), cells, strict=True))
        if not isinstance(cells, dict):
            raise FeederError(f"{where} is no row of cells")
        where += f", id {cells.get('id')!r}"
        for field, value in cells.items():
            fields = self.dtypes[component].fields or {}
            if field in fields:
                largest = float(np.finfo(float).max) if field in _MAY_BE_LARGE else _LARGEST
                self._cell(f"{where}: {field}", fields[field][0], value, field in _MAY_BE_INFINITE, largest)
                continue
            self.extra[component, field] = self.extra.get((component, field), 0) + 1
            if component == "node" and field == "name" and isinstance(value, str) and isinstance(cells.get("id"), int):
                self.names[cells["id"]] = value

    def _cell(self, where: str, dtype: np.dtype[Any], value: object, infinite: bool, largest: float) -> None:
        if value is None:
            return
        if dtype.shape:
            if not isinstance(value, list) or len(value) != dtype.shape[0]:
                raise FeederError(f"{where} is {str(value)[:60]}; give {dtype.shape[0]} numbers")
            for one in value:
                self._cell(where, dtype.base, one, infinite, largest)
        elif infinite and value in ("inf", "+inf", "-inf"):
            return
        elif isinstance(value, bool) or not isinstance(value, int | float):
            raise FeederError(f"{where} is {str(value)[:60]!r}; give a number")
        elif np.issubdtype(dtype, np.integer):
            limits = np.iinfo(dtype)
            if not isinstance(value, int) or not limits.min < value <= limits.max:
                raise FeederError(
                    f"{where} is {str(value)[:60]}; give a whole number of {limits.min + 1} to {limits.max}"
                )
        elif not abs(value) <= largest and not (infinite and abs(value) == np.inf):
            raise FeederError(f"{where} is {str(value)[:60]}; give a finite number")


def _validate(file: str, data: Data) -> None:
    """FeederError with the first of what power-grid-model's own checks find."""
    from power_grid_model import CalculationType
    from power_grid_model.validation import validate_input_data

    errors = validate_input_data(data, calculation_type=CalculationType.power_flow, symmetric=True)  # pyright: ignore
    if not errors:
        return
    first = errors[0]
    component, field, ids = (getattr(first, name, "") for name in ("component", "field", "ids"))
    shown = ", ".join(str(one[1] if isinstance(one, tuple) else one) for one in list(ids)[:5])
    more = f" (and {len(errors) - 1} more errors)" if len(errors) > 1 else ""
    raise FeederError(f"{file}: {_shown(component)} {shown}: {_shown(field)}: {first}{more}")


def _shown(part: Any) -> str:
    parts = part if isinstance(part, list | tuple) else [part]
    return ", ".join(str(getattr(one, "value", one)) for one in parts)
