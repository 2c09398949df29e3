"""Reading and checking a feeder's three files: feeder.toml, buses.csv, branches.csv."""

from __future__ import annotations

import csv
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any

from dcgrid_env.grid.topology import FeederError


def check_lengths(name: str, component: str, n: int, fields: Mapping[str, Sequence[Any] | None]) -> None:
    """Raise FeederError at the first field (None is left out) that has not one value for each of ``n`` rows."""
    for field, values in fields.items():
        if values is not None and len(values) != n:
            raise FeederError(f"feeder {name!r}: {len(values)} values of {field} for {n} {component} rows")


def check_numbers(
    name: str,
    component: str,
    ids: Sequence[Any],
    fields: Mapping[str, Sequence[float]],
    *,
    non_negative: bool = False,
    positive: bool = False,
    may_be_nan: bool = False,
) -> None:
    """Raise FeederError, naming component and field, at the first value that is not finite or of the wrong sign."""
    check_lengths(name, component, len(ids), fields)
    for field, values in fields.items():
        for i, value in zip(ids, values, strict=True):
            if isinstance(value, bool) or not isinstance(value, Real) or (math.isnan(value) and not may_be_nan):
                raise FeederError(f"feeder {name!r}: {component} {i}: {field} is {value!r}; give a finite number")
            if math.isinf(value):
                raise FeederError(f"feeder {name!r}: {component} {i}: {field} is {value!r}; give a finite number")
            if (non_negative and value < 0) or (positive and value <= 0):
                wanted = "> 0" if positive else ">= 0"
                raise FeederError(f"feeder {name!r}: {component} {i}: {field} is {value}; it must be {wanted}")


def read_feeder_tables(folder: Path) -> dict[str, Any]:
    """Read the three files into the arguments of ``Feeder.from_tables``. Bus names are integers where all are.

    Raises
    ------
    FeederError
        For a missing file, key or column, or a cell that is no number, naming the file and the line.
    """
    try:
        head = tomllib.loads(_text(folder / "feeder.toml"))
    except tomllib.TOMLDecodeError as error:
        raise FeederError(f"{folder / 'feeder.toml'}: {error}") from None
    for key in ("name", "base_kv", "substation", "v0_pu"):
        if key not in head:
            raise FeederError(f"{folder / 'feeder.toml'}: the key {key!r} is missing")
    for key in ("base_kv", "v0_pu"):
        if isinstance(head[key], bool) or not isinstance(head[key], int | float):
            raise FeederError(f"{folder / 'feeder.toml'}: {key} is {head[key]!r}; give a number")
    buses = _columns(
        folder / "buses.csv",
        ["bus"],
        {"p_kw": None, "q_kvar": None, "capacitor_kvar": 0.0, "x": math.nan, "y": math.nan},
    )
    branches = _columns(folder / "branches.csv", ["from_bus", "to_bus"], {"r_ohm": None, "x_ohm": None})
    texts = [*buses["bus"], *branches["from_bus"], *branches["to_bus"], str(head["substation"])]
    as_id = int if all(re.fullmatch(r"-?[0-9]+", t) for t in texts) else str
    return {
        "name": str(head["name"]),
        "base_kv": head["base_kv"],
        "substation": as_id(str(head["substation"])),
        "v0_pu": head["v0_pu"],
        "bus_ids": [as_id(b) for b in buses["bus"]],
        "p_load_kw": buses["p_kw"],
        "q_load_kvar": buses["q_kvar"],
        "capacitor_kvar": buses["capacitor_kvar"],
        "x": buses["x"],
        "y": buses["y"],
        "from_bus": [as_id(b) for b in branches["from_bus"]],
        "to_bus": [as_id(b) for b in branches["to_bus"]],
        "r_ohm": branches["r_ohm"],
        "x_ohm": branches["x_ohm"],
    }


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FeederError(f"{path} is missing; a feeder is feeder.toml, buses.csv and branches.csv") from None
    except UnicodeDecodeError as error:
        raise FeederError(f"{path}: {error}; save it as UTF-8") from None


def _columns(path: Path, names: list[str], numbers: dict[str, float | None]) -> dict[str, list[Any]]:
    """Columns of a CSV file; ``numbers`` maps a numeric column to its default, None where it must be given."""
    reader = csv.DictReader(_text(path).splitlines())
    header = reader.fieldnames or []
    missing = [c for c in [*names, *(n for n, default in numbers.items() if default is None)] if c not in header]
    if missing:
        raise FeederError(f"{path}: the column {missing[0]!r} is missing; the file has {list(header)}")
    columns: dict[str, list[Any]] = {c: [] for c in [*names, *numbers]}
    for row in reader:
        for c in names:
            text = (row[c] or "").strip()
            if not text:
                raise FeederError(f"{path}, line {reader.line_num}: {c} is empty")
            columns[c].append(text)
        for c, default in numbers.items():
            text = (row.get(c) or "").strip()
            if not text and default is not None:
                columns[c].append(default)
                continue
            try:
                columns[c].append(float(text))
            except ValueError:
                raise FeederError(f"{path}, line {reader.line_num}: {c} is {text!r}; give a number") from None
    return columns
