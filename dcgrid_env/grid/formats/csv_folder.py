"""A balanced feeder as a folder, read and written: feeder.toml, buses.csv, branches.csv and, if known, ratings.csv.

``feeder.toml``: name, base_kv (line to line), substation (bus), v0_pu, and about, source, licence as texts for readers.
``buses.csv``: bus, p_kw, q_kvar and, if known, capacitor_kvar, x, y, shunt_kw, shunt_kvar, voltage_ratio, base_kv.
``branches.csv``: from_bus, to_bus, r_ohm, x_ohm and, if known, rating_a. ``ratings.csv``: see ``ratings_file``.

An empty cell of an optional column means: without capacitor or shunt, a ratio of 1, the feeder's base voltage, an
unknown coordinate or rating. Other keys and columns are refused, because a misspelt one would be ignored silently.
"""

from __future__ import annotations

import csv
import io
import json
import math
import tomllib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from dcgrid_env.core.files import write_text
from dcgrid_env.grid.formats.ratings_file import RATINGS_FILE, ratings_text, read_ratings
from dcgrid_env.grid.network import LineTable, Network, NodeTable, balanced_network, summed_at_nodes
from dcgrid_env.grid.network_checks import check_balanced
from dcgrid_env.grid.topology import FeederError

_KEYS = ("name", "base_kv", "substation", "v0_pu")
_SHUNTS = {"shunt_kw": 0.0, "shunt_kvar": 0.0}
_OF_NODES = {"base_kv": math.nan, "voltage_ratio": math.nan}
_TEXTS = ("about", "source", "licence")
"""Keys of feeder.toml that are for readers."""


def read_csv(folder: Path) -> Network:
    """Read the files of a folder.

    Raises
    ------
    FeederError
        For a missing or unknown file, key or column, or a cell that is not a number, naming the file and the line.
    """
    try:
        head = tomllib.loads(_text(folder / "feeder.toml"))
    except tomllib.TOMLDecodeError as error:
        raise FeederError(f"{folder / 'feeder.toml'}: {error}") from None
    for key in head:
        if key not in (*_KEYS, *_TEXTS):
            there = ", ".join((*_KEYS, *_TEXTS))
            raise FeederError(f"{folder / 'feeder.toml'}: {key!r} is no key of a feeder; there are {there}")
    for key in _KEYS:
        if key not in head:
            raise FeederError(f"{folder / 'feeder.toml'}: the key {key!r} is missing")
    for key in ("base_kv", "v0_pu"):
        if isinstance(head[key], bool) or not isinstance(head[key], int | float):
            raise FeederError(f"{folder / 'feeder.toml'}: {key} is {head[key]!r}; give a number")
    buses = _columns(
        folder / "buses.csv",
        ["bus"],
        {"p_kw": None, "q_kvar": None, "capacitor_kvar": 0.0, "x": math.nan, "y": math.nan},
        _SHUNTS | _OF_NODES,
    )
    branches = _columns(
        folder / "branches.csv", ["from_bus", "to_bus"], {"r_ohm": None, "x_ohm": None}, {"rating_a": math.nan}
    )
    network = balanced_network(
        str(head["name"]),
        base_kv=head["base_kv"],
        substation=str(head["substation"]),
        v0_pu=head["v0_pu"],
        nodes=NodeTable(
            buses["bus"],
            [0] * len(buses["bus"]),
            buses["x"],
            buses["y"],
            **{column: buses.get(column, ()) for column in _OF_NODES},
        ),
        p_kw=buses["p_kw"],
        q_kvar=buses["q_kvar"],
        capacitor_kvar=buses["capacitor_kvar"],
        lines=LineTable(**branches),
        **{column: buses.get(column) for column in _SHUNTS},
    )
    return replace(network, rating=read_ratings(folder))


def write_csv(network: Network, folder: Path) -> None:
    """Write a balanced network as the files of a folder, which is made; figures read back to the bit.

    Several loads or capacitors at a bus become one, their sum.

    Raises
    ------
    FeederError
        For a network that is not balanced, or a bus whose text a CSV file cannot give back; nothing is written.
    """
    check_balanced(network)
    for bus in (*network.source.bus, *network.node.bus, *network.line.from_bus, *network.line.to_bus):
        if bus != bus.strip() or len(bus.splitlines()) != 1:
            raise FeederError(
                f"feeder {network.name!r}: bus {bus!r} cannot be written; leave out spaces at its ends and line ends"
            )
    load, shunt, node, line = network.load, network.shunt, network.node, network.line
    p_kw, q_kvar, capacitor_kvar = (
        summed_at_nodes(node, buses, values)
        for buses, values in ((load.bus, load.p_kw), (load.bus, load.q_kvar), (shunt.bus, shunt.capacitor_kvar))
    )
    buses = {"bus": node.bus, "p_kw": p_kw, "q_kvar": q_kvar, "capacitor_kvar": capacitor_kvar, "x": node.x}
    buses |= {"y": node.y}
    for column in _SHUNTS:
        if getattr(shunt, column):
            buses[column] = summed_at_nodes(node, shunt.bus, getattr(shunt, column))
    buses |= {column: getattr(node, column) for column in _OF_NODES if getattr(node, column)}
    branches = {column: getattr(line, column) for column in ("from_bus", "to_bus", "r_ohm", "x_ohm", "rating_a")}
    if not line.rating_a:
        del branches["rating_a"]
    ratings = ratings_text(network.rating) if len(network.rating) else ""
    write_text(folder / "buses.csv", _csv(buses))
    write_text(folder / "branches.csv", _csv(branches))
    if ratings:
        write_text(folder / RATINGS_FILE, ratings)
    source = network.source
    head = {"name": network.name, "base_kv": float(source.base_kv[0])}
    head |= {"substation": source.bus[0], "v0_pu": float(source.v_pu[0])}
    # Last: without it the folder is no feeder. TOML's basic strings are JSON's, but for the one character.
    lines = (f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in head.items())
    write_text(folder / "feeder.toml", "".join(lines).replace("\x7f", "\\u007f"))


def _csv(columns: dict[str, Iterable[Any]]) -> str:
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    writer.writerow(columns)
    rows = zip(*columns.values(), strict=True)
    writer.writerows([v if isinstance(v, str) else _figure(float(v)) for v in row] for row in rows)
    return written.getvalue()


def _figure(value: float) -> str:
    return "" if math.isnan(value) else repr(value)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FeederError(f"{path} is missing; a balanced feeder is feeder.toml, buses.csv and branches.csv") from None
    except UnicodeDecodeError as error:
        raise FeederError(f"{path}: {error}; save it as UTF-8") from None
    except OSError as error:
        raise FeederError(f"{path} cannot be read ({error.strerror}); give a file") from None


def _columns(
    path: Path, names: list[str], numbers: dict[str, float | None], optional: dict[str, float]
) -> dict[str, list[Any]]:
    """Columns of a CSV file; ``numbers`` maps a numeric column to its default, None where it must be given.

    ``optional`` columns, with the default of an empty cell, are in the result only where the file has them.
    """
    reader = csv.DictReader(_text(path).splitlines())
    header = reader.fieldnames or []
    missing = [c for c in [*names, *(n for n, default in numbers.items() if default is None)] if c not in header]
    if missing:
        raise FeederError(f"{path}: the column {missing[0]!r} is missing; the file has {list(header)}")
    for i, c in enumerate(header):
        if c not in (*names, *numbers, *optional):
            there = ", ".join((*names, *numbers, *optional))
            raise FeederError(f"{path}: {c!r} is no column of it; there are {there}")
        if c in header[:i]:
            raise FeederError(f"{path}: the column {c!r} is there twice; leave one out")
    numbers = numbers | {c: default for c, default in optional.items() if c in header}
    columns: dict[str, list[Any]] = {c: [] for c in [*names, *numbers]}
    for row in reader:
        if None in row:
            raise FeederError(f"{path}, line {reader.line_num}: more cells than {len(header)} columns; take them out")
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
