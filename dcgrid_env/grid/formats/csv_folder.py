"""A balanced feeder as a folder, read and written: feeder.toml, buses.csv, branches.csv and, if known, ratings.csv.

``feeder.toml``: name, base_kv (line to line), substation (bus), v0_pu, and about, source, licence as texts for readers.
That of an unverified import has a table ``import`` in addition: see ``import_stamp``.
``buses.csv``: bus, p_kw, q_kvar and, if known, capacitor_kvar, x, y, shunt_kw, shunt_kvar, voltage_ratio, base_kv.
``branches.csv``: from_bus, to_bus, r_ohm, x_ohm and, if known, rating_a. ``ratings.csv``: see ``ratings_file``.

An empty cell of an optional column means: without capacitor or shunt, a ratio of 1, the feeder's base voltage, an
unknown coordinate or rating. Other keys and columns are refused, because a misspelt one would be ignored silently.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from dcgrid_env.grid.formats.feeder_folder import write_files
from dcgrid_env.grid.formats.feeder_tables import cell_number, head_of, table_rows, table_text
from dcgrid_env.grid.formats.import_stamp import without_stamp
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
    head = without_stamp(folder / "feeder.toml", head_of(folder / "feeder.toml"))
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
    texts = {"buses.csv": _table(buses), "branches.csv": _table(branches)}
    if len(network.rating):
        texts[RATINGS_FILE] = ratings_text(network.rating)
    source = network.source
    head = {"name": network.name, "base_kv": float(source.base_kv[0])}
    head |= {"substation": source.bus[0], "v0_pu": float(source.v_pu[0])}
    # TOML's basic strings are JSON's, but for the one character.
    lines = (f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in head.items())
    write_files(folder, texts, "".join(lines).replace("\x7f", "\\u007f"))


def _table(columns: dict[str, Iterable[Any]]) -> str:
    rows = zip(*columns.values(), strict=True)
    return table_text(list(columns), ([v if isinstance(v, str) else float(v) for v in row] for row in rows))


def _columns(
    path: Path, names: list[str], numbers: dict[str, float | None], optional: dict[str, float]
) -> dict[str, list[Any]]:
    """Columns of a CSV file; ``numbers`` maps a numeric column to its default, None where it must be given.

    ``optional`` columns, with the default of an empty cell, are in the result only where the file has them.
    """
    needed = [*names, *(column for column, default in numbers.items() if default is None)]
    columns: dict[str, list[Any]] = {column: [] for column in [*names, *numbers]}
    for line, row in table_rows(path, needed, [column for column in [*numbers, *optional] if column not in needed]):
        for column in names:
            if not row[column]:
                raise FeederError(f"{path}, line {line}: {column} is empty")
            columns[column].append(row[column])
        for column, default in (numbers | {column: optional[column] for column in optional if column in row}).items():
            value = cell_number(path, line, column, row.get(column, ""), default)
            columns.setdefault(column, []).append(value)
    return columns
