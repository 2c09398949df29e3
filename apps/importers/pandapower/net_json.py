"""A pandapower net from its JSON file, without importing or calling anything that the file names.

pandapower's reader imports modules, creates objects of classes and opens files that the JSON file names.
Here the tables that a power flow needs are filled from plain figures and texts; controllers, functions and other
objects are not created.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.pandapower.net_schema import LARGEST_INDEX, REFUSED, SCHEMA, PandapowerNet
from dcgrid_env.core.user_files import parse_json, read_json
from dcgrid_env.grid.topology import FeederError

_REMEDY = "give a JSON file that pandapower.to_json wrote"
_PLAIN_TABLES = (*SCHEMA, *REFUSED, "bus_dc", "trafo_characteristic_table", "shunt_characteristic_table", "bus_geodata")
_NO_MATTER = {"std_types", "measurement", "pwl_cost", "poly_cost", "group", "user_pf_options", "controller"}


def net_from_json(path: Path, report: Report) -> PandapowerNet:
    """The net of a file; FeederError for a file that holds none, naming table, row and column."""
    members = _members(path)
    tables = {name: _table(str(path), name, members[name]) for name in _PLAIN_TABLES if _is_table(members.get(name))}
    if "bus" not in tables:
        raise FeederError(f"{path}: the table bus is missing; give a net that pandapower.to_json wrote")
    _report_rest(str(path), members, report)
    net = _assembled(str(path), members, tables)
    profiles = members.get("profiles")
    if isinstance(profiles, dict):
        net["profiles"] = {
            name: _profiles_of(str(path), name, member) for name, member in profiles.items() if _is_table(member)
        }
    return net


def _profiles_of(file: str, name: str, member: dict[str, Any]) -> Any:
    """A table of profiles, whose cells are checked where they are used."""
    import pandas

    table = _table(file, f"profiles.{name}", member)
    return pandas.DataFrame(table["data"], columns=table["columns"])


def _members(path: Path) -> dict[str, Any]:
    """What stands under the file's ``_object``."""
    try:
        whole = read_json(path, FeederError, _REMEDY)
    except OSError as error:
        raise FeederError(f"{path} cannot be read ({error.strerror}); give a pandapower net") from None
    members = whole.get("_object") if isinstance(whole, dict) else None
    if not isinstance(members, dict) or whole.get("_class") != "pandapowerNet":
        raise FeederError(f"{path} is no pandapower net; give a file that pandapower.to_json wrote")
    return members


def _is_table(member: object) -> bool:
    return isinstance(member, dict) and member.get("_class") == "DataFrame"


def _table(file: str, name: str, member: dict[str, Any]) -> dict[str, Any]:
    """Columns, index and data of a table."""
    where = f"{file}, table {name}"
    if member.get("orient", "split") != "split":
        raise FeederError(f"{where}: its orient is {member['orient']!r}; write the net anew by pandapower.to_json")
    content = member.get("_object")
    if isinstance(content, str):
        content = parse_json(content, where, FeederError, _REMEDY)
    if not isinstance(content, dict) or not {"columns", "index", "data"} <= set(content):
        raise FeederError(f"{where}: it has no columns, index and data")
    columns, index, data = content["columns"], content["index"], content["data"]
    if not all(isinstance(part, list) for part in (columns, index, data)) or len(index) != len(data):
        raise FeederError(f"{where}: index and data are no lists of one length")
    if not all(isinstance(column, str) for column in columns) or len(set(columns)) < len(columns):
        raise FeederError(f"{where}: its columns are no different texts")
    for i, row in zip(index, data, strict=True):
        if isinstance(i, bool) or not isinstance(i, int) or not 0 <= i <= LARGEST_INDEX:
            raise FeederError(f"{where}: the index {i!r} is no whole number of 0 to {LARGEST_INDEX}")
        if not isinstance(row, list) or len(row) != len(columns):
            raise FeederError(f"{where}, index {i}: the row has not one cell for each of {len(columns)} columns")
    return {"columns": columns, "index": index, "data": data}


def _assembled(file: str, members: dict[str, Any], tables: dict[str, dict[str, Any]]) -> PandapowerNet:
    """An empty net with the tables in it."""
    import pandapower
    import pandas

    net = pandapower.create_empty_network()
    for key in ("sn_mva", "f_hz"):
        value = members.get(key, net[key])
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e9:
            raise FeederError(f"{file}: {key} is {value!r}; give a positive number")
        net[key] = float(value)
    net["name"] = str(members.get("name") or "")
    options = members.get("user_pf_options")
    if isinstance(options, dict):
        net["user_pf_options"] = {str(name): None for name in options}
    for name, table in tables.items():
        if not table["index"]:
            continue
        frame = pandas.DataFrame(table["data"], index=table["index"], columns=table["columns"], dtype=object)
        like = net[name] if name in net else pandas.DataFrame()
        columns = {column: _column(file, name, column, frame[column], like) for column in frame.columns}
        typed = pandas.DataFrame(columns, index=pandas.Index(table["index"], dtype="int64"))
        for column in like.columns:
            if column not in typed.columns and column not in SCHEMA.get(name, {}):
                typed[column] = pandas.Series([None] * len(typed), index=typed.index, dtype=object)
        net[name] = typed
    version = members.get("format_version")
    if isinstance(version, str) and version != str(net.get("format_version")):
        net["format_version"] = version
        try:
            pandapower.convert_format(net)
        except Exception as error:
            raise FeederError(f"{file}: format {version[:20]!r} cannot be converted ({str(error)[:120]})") from None
    return net


def _column(file: str, table: str, column: str, cells: Any, like: Any) -> Any:
    """A column with the type that pandapower gives it; objects and lists in it are not made."""
    kind = SCHEMA.get(table, {}).get(column, "")
    values: list[Any] = [None if isinstance(cell, dict | list) else cell for cell in cells]
    right = {bool} if kind == "bool" else {float}
    if kind and not set(map(type, values)) <= right:
        wanted = bool if kind == "bool" else (int, float)
        for i, cell in zip(cells.index, cells, strict=True):
            empty = cell is None and kind.endswith("?")
            if not empty and (not isinstance(cell, wanted) or isinstance(cell, bool) != (kind == "bool")):
                expected = "true or false" if kind == "bool" else "a number"
                raise FeederError(f"{file}, table {table}, index {i}: {column} is {str(cell)[:60]!r}; give {expected}")
            if isinstance(cell, int) and abs(cell) > 2**62:
                raise FeederError(f"{file}, table {table}, index {i}: {column} is {str(cell)[:60]}; it is too large")
    series = cells.__class__(values, index=cells.index, dtype=object)
    if kind == "bool":
        return series.astype(bool)
    whole = kind == "bus" or (table, column) == ("switch", "element")
    if whole and all(math.isfinite(cell) and cell == int(cell) for cell in values):
        return series.astype("int64")
    if kind:
        return series.astype(float)
    like_type = like[column].dtype.kind if column in like.columns else "O"
    if like_type == "b" and all(cell is None or isinstance(cell, bool) for cell in values):
        return series.map(bool).astype(bool)
    if like_type in "iuf" and all(cell is None or type(cell) in (int, float) for cell in values):
        return series.map(lambda cell: math.nan if cell is None else cell).astype(float)
    return series


def _report_rest(file: str, members: dict[str, Any], report: Report) -> None:
    """Report the parts of the file that are not read."""
    for name, member in members.items():
        if name in _PLAIN_TABLES or name.startswith(("res_", "_")) or not _is_table(member):
            continue
        try:
            rows = _table(file, name, member)["index"]
        except FeederError:
            rows = ["?"]
        if rows and name == "controller":
            report.add_all("lost", "controller", map(str, rows), "it moves nothing: taps and powers stay as they are")
        elif rows and name not in _NO_MATTER:
            report.add("nothing lost", "table", name, "the balanced power flow has no use for it")
