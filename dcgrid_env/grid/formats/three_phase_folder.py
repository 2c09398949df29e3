"""A three-phase feeder as a folder of tables, read and written.

``feeder.toml``: name, frequency_hz, source_of_facts, and the table ``source``: bus, base_kv_ll, v_pu, angle_deg and the
3x3 matrices r_ohm and x_ohm. ``buses.csv``, ``lines.csv``, ``switches.csv``, ``transformers.csv``, ``regulators.csv``,
``loads.csv``, ``capacitors.csv``, ``capacitor_controls.csv``, ``cores.csv`` and ``admittances.csv``: a column for each
of ``grid.three_phase_tables``, whose units they have; matrices as r_aa_ohm, r_ab_ohm, .. of the upper triangle, legs as
kw_1, kvar_1, .. or kvar_a, .. . Matrices of admittances.csv are one cell, figures separated by blanks. All files but
buses.csv and feeder.toml may be missing; the last three are written where there are such rows. ``ratings.csv``, also
optional, is described in ``ratings_file``.
``feeder.toml`` of an unverified import has a table ``import`` in addition: see ``import_stamp``.
Unused keys and columns are refused by name. The exceptions are the results of a reference solution in published
folders (``RESULTS``).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from dcgrid_env.grid.formats.feeder_folder import write_files
from dcgrid_env.grid.formats.feeder_tables import cell_number, head_of, table_rows, table_text
from dcgrid_env.grid.formats.import_stamp import without_stamp
from dcgrid_env.grid.formats.ratings_file import RATINGS_FILE, ratings_text, read_ratings
from dcgrid_env.grid.formats.three_phase_columns import FILES, Column, File, says_nothing
from dcgrid_env.grid.network import Network, NodeTable, SourceTable
from dcgrid_env.grid.three_phase_checks import check_three_phase
from dcgrid_env.grid.three_phase_tables import FALLBACKS, LETTERS
from dcgrid_env.grid.topology import FeederError

_HEAD = ("name", "frequency_hz", "source_of_facts", "source")
_SOURCE = ("bus", "base_kv_ll", "v_pu", "angle_deg", "r_ohm", "x_ohm")
RESULTS = {"feeder.toml": ("engine", "engine_detail", "golden", "regulated"), "regulators.csv": ("tap_regulated",)}
"""Keys and columns on the method and the results of a reference program; they are not stored."""


def read_folder(folder: Path) -> Network:
    """Read the tables of a folder.

    Raises
    ------
    FeederError
        For a missing or unknown file, key or column, or a cell that is not a number, naming file and line.
    """
    head, source = _read_head(folder / "feeder.toml")
    tables = {kind: _read_table(folder, file) for kind, file in FILES.items()}
    return Network(
        name=head["name"],
        source=SourceTable(*([source[key]] for key in _SOURCE)),
        node=_read_buses(folder / "buses.csv"),
        frequency_hz=head.get("frequency_hz", 60.0),
        source_of_facts=head.get("source_of_facts", ""),
        rating=read_ratings(folder),
        **tables,
    )


def write_folder(network: Network, folder: Path) -> None:
    """Write a three-phase network as the tables of a folder, which is made; figures read back to the bit.

    Raises
    ------
    FeederError
        For a network that is not three-phase, or a text that a CSV file cannot give back; nothing is written.
    """
    check_three_phase(network)
    texts = {"buses.csv": table_text(["bus", "phases", "base_kv_ln", "x", "y"], _bus_rows(network.node))}
    for kind, file in FILES.items():
        table = getattr(network, kind)
        if kind in ("core", "admittance", "capacitor_control") and not len(table):  # published folders have none
            continue
        columns = [(column, getattr(table, column.field)) for column in file.columns]
        unused = {column.field for column in file.columns if says_nothing(column.field, vars(table))}
        if not any(any(shares) for shares in getattr(table, "zip", ())):
            unused.add("zip")
        columns = [(column, values) for column, values in columns if column.field not in unused]
        rows = ([cell for column, values in columns for cell in column.cells(values[k])] for k in range(len(table)))
        may_be_empty = [column.may_be_empty for column, _ in columns for _ in column.names]
        texts[file.name] = table_text([name for column, _ in columns for name in column.names], rows, may_be_empty)
    if len(network.rating):
        texts[RATINGS_FILE] = ratings_text(network.rating)
    source = network.source
    head = {"name": network.name, "source_of_facts": network.source_of_facts, "frequency_hz": network.frequency_hz}
    values = (source.bus[0], source.base_kv[0], source.v_pu[0], source.angle_deg[0], source.r_ohm[0], source.x_ohm[0])
    lines = [*_toml(head.items()), "\n[source]\n", *_toml(zip(_SOURCE, values, strict=True))]
    write_files(folder, texts, "".join(lines))


def _toml(pairs: Iterable[tuple[str, Any]]) -> list[str]:
    # TOML's basic strings are JSON's, but for the one character.
    written = ((key, value if isinstance(value, str | tuple) else float(value)) for key, value in pairs)
    return [f"{k} = {json.dumps(v, ensure_ascii=False)}\n".replace("\x7f", "\\u007f") for k, v in written]


def _read_head(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    head = without_stamp(path, head_of(path))
    source = head.get("source")
    if not isinstance(source, dict):
        raise FeederError(f"{path}: the table [source] is missing")
    for keys, needed, known in ((head, ("name",), (*_HEAD, *RESULTS["feeder.toml"])), (source, _SOURCE, _SOURCE)):
        for key in needed:
            if key not in keys:
                raise FeederError(f"{path}: the key {key!r} is missing")
        for key in keys:
            if key not in known:
                raise FeederError(f"{path}: the key {key!r} is not known; choose {', '.join(known)}")
    for keys, texts in ((head, ("name", "source_of_facts")), (source, ("bus",))):
        for key in texts:
            if not isinstance(keys.get(key, ""), str):
                raise FeederError(f"{path}: {key} is {keys[key]!r}; give a text")
    try:
        return _as_floats(head), _as_floats(source)
    except OverflowError:
        raise FeederError(f"{path}: a number is too large; give one below 1e308") from None


def _as_floats(value: Any) -> Any:
    """TOML's integers as the numbers that they mean."""
    if isinstance(value, dict):
        return {key: _as_floats(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_as_floats(one) for one in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _read_buses(path: Path) -> NodeTable:
    rows: list[tuple] = []
    before: set[str] = set()
    for line, row in table_rows(path, ["bus", "phases", "base_kv_ln"], ["x", "y"]):
        figures = [cell_number(path, line, c, row.get(c, ""), math.nan) for c in ("x", "y")]
        base_kv = cell_number(path, line, "base_kv_ln", row["base_kv_ln"])
        if not row["phases"] or sorted(set(row["phases"]) & set(LETTERS)) != list(row["phases"]):
            raise FeederError(
                f"{path}, line {line}: phases is {row['phases']!r}; give letters in order, a, b, c for the phases and "
                "others for other conductors"
            )
        if not row["bus"] or row["bus"] in before:
            raise FeederError(f"{path}, line {line}: bus is {row['bus']!r}; give each bus one row and its own text")
        before.add(row["bus"])
        rows += [(row["bus"], LETTERS.index(phase) + 1, *figures, base_kv) for phase in row["phases"]]
    return NodeTable(*zip(*rows, strict=True)) if rows else NodeTable()


def _bus_rows(node: NodeTable) -> Iterable[Sequence[Any]]:
    last = 0
    for k, bus in enumerate(node.bus):
        if k + 1 == len(node) or node.bus[k + 1] != bus:
            phases = "".join(LETTERS[phase - 1] for phase in node.phase[last : k + 1])
            yield bus, phases, node.base_kv_ln[k], node.x[k], node.y[k]
            last = k + 1


def _read_table(folder: Path, file: File) -> Any:
    path = folder / file.name
    if not path.exists():
        return file.table()
    needed = [name for column in file.columns if not column.may_be_missing for name in column.names]
    more = [name for column in file.columns if column.may_be_missing for name in column.names]
    columns: dict[str, list[Any]] = {column.field: [] for column in file.columns}
    for line, row in table_rows(path, needed, more, RESULTS.get(file.name, ())):
        for column in file.columns:
            if column.field in FALLBACKS and column.field not in row:
                continue
            if column.if_missing is not None and column.field not in row:
                row[column.field] = column.if_missing
            columns[column.field].append(_read_cells(path, line, row, column))
    return file.table(**{name: values for name, values in columns.items() if not says_nothing(name, columns)})


def _read_cells(path: Path, line: int, row: dict[str, str], column: Column) -> Any:
    cells = []
    for name in column.names:
        text = row.get(name, "")
        if column.shape == "list":
            cells += [cell_number(path, line, name, word) for word in text.split()]
        elif column.is_text:
            if not text and not column.may_be_empty:
                raise FeederError(f"{path}, line {line}: {name} is empty")
            cells.append(text)
        elif not column.is_whole:
            cells.append(cell_number(path, line, name, text, math.nan if column.may_be_empty else None))
        else:
            value = cell_number(path, line, name, text)
            cells.append(int(value) if value == int(value) else value)
    return column.joined(cells)
