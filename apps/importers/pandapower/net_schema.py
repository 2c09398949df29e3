"""What the columns of a pandapower net's tables may hold, and the check of a net against it."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.grid.topology import FeederError

PandapowerNet = Any
"""A ``pandapowerNet``; pandapower is optional and its tables have no types."""
_LARGEST = 1e12
LARGEST_INDEX = 10_000_000
"""Largest index of an element: pandapower makes arrays of that length."""
_POWER = {"bus": "bus", "p_mw": "number", "q_mvar": "number", "scaling": "number", "in_service": "bool"}
_THREE = {f"{kind}_{phase}_{unit}": "number" for kind, unit in (("p", "mw"), ("q", "mvar")) for phase in "abc"}
_TAP = {
    "tap_neutral": "number?", "tap_min": "number?", "tap_max": "number?", "tap_pos": "number?",
    "tap_step_percent": "number?", "tap_step_degree": "number?",
}  # fmt: skip
_SHARE = {f"const_{kind}_{power}_percent": "share" for kind in "zi" for power in "pq"}
SCHEMA: dict[str, dict[str, str]] = {
    "bus": {"vn_kv": "positive", "in_service": "bool"},
    "ext_grid": {"bus": "bus", "vm_pu": "positive", "va_degree": "number?", "in_service": "bool"},
    "load": _POWER | _SHARE,
    "sgen": _POWER,
    "storage": _POWER,
    "asymmetric_load": {"bus": "bus", "scaling": "number", "in_service": "bool"} | _THREE,
    "asymmetric_sgen": {"bus": "bus", "scaling": "number", "in_service": "bool"} | _THREE,
    "motor": {
        "bus": "bus", "pn_mech_mw": "number", "loading_percent": "number", "cos_phi": "positive",
        "efficiency_percent": "positive", "scaling": "number", "in_service": "bool",
    },
    "gen": {
        "bus": "bus", "p_mw": "number", "vm_pu": "positive", "scaling": "number", "slack": "bool", "in_service": "bool",
    },
    "shunt": {
        "bus": "bus", "p_mw": "number", "q_mvar": "number", "vn_kv": "positive?", "step": "number",
        "in_service": "bool",
    },
    "ward": {
        "bus": "bus", "ps_mw": "number", "qs_mvar": "number", "pz_mw": "number", "qz_mvar": "number",
        "in_service": "bool",
    },
    "line": {
        "from_bus": "bus", "to_bus": "bus", "length_km": "positive", "r_ohm_per_km": "not negative",
        "x_ohm_per_km": "not negative", "c_nf_per_km": "not negative", "g_us_per_km": "not negative",
        "max_i_ka": "positive?", "df": "positive", "parallel": "positive", "in_service": "bool",
    },
    "trafo": {
        "hv_bus": "bus", "lv_bus": "bus", "sn_mva": "positive", "vn_hv_kv": "positive", "vn_lv_kv": "positive",
        "vk_percent": "positive", "vkr_percent": "not negative", "pfe_kw": "not negative", "i0_percent": "not negative",
        "shift_degree": "number", "parallel": "positive", "df": "positive", "in_service": "bool",
    } | _TAP,
    "trafo3w": {
        "hv_bus": "bus", "mv_bus": "bus", "lv_bus": "bus", "in_service": "bool", "pfe_kw": "not negative",
        "i0_percent": "not negative", "shift_mv_degree": "number", "shift_lv_degree": "number",
    } | {f"{name}_{side}_{unit}": "positive" for side in ("hv", "mv", "lv") for name, unit in
         (("sn", "mva"), ("vn", "kv"), ("vk", "percent"))}
    | {f"vkr_{side}_percent": "not negative" for side in ("hv", "mv", "lv")} | _TAP,
    "impedance": {
        "from_bus": "bus", "to_bus": "bus", "rft_pu": "number", "xft_pu": "number", "rtf_pu": "number",
        "xtf_pu": "number",
        "gf_pu": "number", "bf_pu": "number", "gt_pu": "number", "bt_pu": "number", "sn_mva": "positive",
        "in_service": "bool",
    },
    "switch": {"bus": "bus", "element": "number", "closed": "bool", "z_ohm": "not negative"},
}  # fmt: skip
"""Columns that decide voltages, by table, and what each may hold; ``?`` allows an empty cell."""
REFUSED = {
    "xward": "it keeps a voltage behind an impedance",
    "dcline": "a DC line",
    "line_dc": "a DC line",
    "svc": "a static var compensator",
    "tcsc": "a series compensator",
    "ssc": "a static synchronous compensator",
    "vsc": "a converter",
    "vsc_stacked": "a converter",
    "vsc_bipolar": "a converter",
    "source_dc": "a DC source",
    "load_dc": "a DC load",
}
"""Tables of what no balanced feeder has, and what their elements are."""
EMPTY_WORDS = (None, "", "nan", "None")
"""Contents of an empty cell of words; pandapower itself writes "nan" for transformers of three windings."""
_WORDS = {
    ("switch", "et"): ("b", "l", "t", "t3"),
    ("trafo", "tap_side"): ("hv", "lv"),
    ("trafo3w", "tap_side"): ("hv", "mv", "lv"),
    ("trafo", "tap_changer_type"): ("Ratio", "Symmetrical", "Ideal", "Tabular"),
    ("trafo3w", "tap_changer_type"): ("Ratio", "Symmetrical", "Ideal", "Tabular"),
}
"""Allowed texts of text columns; pandapower handles empty cells, which are "" where 3.2 creates several at once."""
_OPTIONAL_COLUMNS = {
    "tap_neutral", "tap_min", "tap_max", "tap_pos", "tap_step_percent", "tap_step_degree", "vn_kv", "max_i_ka",
    "va_degree", "gf_pu", "bf_pu", "gt_pu", "bt_pu", "z_ohm", "df", "g_us_per_km", *_SHARE,
}  # fmt: skip
_WANTED = {
    "bus": "an index of the table bus",
    "bool": "true or false",
    "number": "a finite number",
    "positive": "a number above 0",
    "not negative": "a number of at least 0",
    "share": "a number of percent, 0 to 100",
}


def check_net(source: str, net: PandapowerNet) -> None:
    """FeederError at the first cell of a net that cannot be used, naming table, index and column."""
    tables = [name for name in SCHEMA if len(net[name])]
    for name in (*tables, *(name for name in REFUSED if name in net and len(net[name]))):
        _check_index(source, name, net[name].index)
    buses = set(net.bus.index.tolist())
    for name in tables:
        table = net[name]
        for column, kind in SCHEMA[name].items():
            if column not in table.columns:
                if column in _OPTIONAL_COLUMNS and not (name == "bus" and column == "vn_kv"):
                    continue
                raise FeederError(f"{source}, table {name}: the column {column} is missing")
            _check_cells(source, name, table, column, kind, buses)
    for name in REFUSED:
        if name in net and len(net[name]) and "in_service" in net[name].columns:
            _check_cells(source, name, net[name], "in_service", "bool", buses)
    for (name, column), words in _WORDS.items():
        if column in net[name].columns:
            for i, cell in zip(net[name].index, net[name][column], strict=True):
                if cell not in (*EMPTY_WORDS, *words) and cell == cell:
                    text = f"{column} is {str(cell)[:60]!r}; it is {' or '.join(words)}"
                    raise FeederError(f"{source}, table {name}, index {i}: {text}")
    _check_switches(source, net)
    _check_ends(source, net)


def _check_cells(source: str, name: str, table: Any, column: str, kind: str, buses: set[int]) -> None:
    """FeederError at the first cell of a column that its kind does not allow."""
    kind, empty, _ = kind.partition("?")
    cells = table[column]
    if _all_good(kind, cells.to_numpy(), bool(empty), buses):
        return
    for i, cell in zip(table.index.tolist(), cells.tolist(), strict=True):
        if empty and (cell is None or cell != cell):
            continue
        if not _is_good(kind, cell, buses):
            raise FeederError(
                f"{source}, table {name}, index {i}: {column} is {str(cell)[:60]!r}; give {_WANTED[kind]}"
            )


def _limits(kind: str) -> tuple[float, float]:
    low = {"positive": 1e-12, "not negative": 0.0, "share": 0.0}.get(kind, -_LARGEST)
    return low, 100.0 if kind == "share" else _LARGEST


def _all_good(kind: str, cells: np.ndarray, empty: bool, buses: set[int]) -> bool:
    """Return whether a column of numbers is valid as a whole; other columns are checked cell by cell."""
    if cells.dtype.kind == "b" or kind == "bool":
        return cells.dtype.kind == "b" and kind == "bool"
    if cells.dtype.kind not in "iuf":
        return False
    if kind == "bus":
        return bool(np.isin(cells, np.fromiter(buses, dtype=np.int64, count=len(buses))).all())
    low, high = _limits(kind)
    return bool((((cells >= low) & (cells <= high)) | (np.isnan(cells) if empty else False)).all())


def _is_good(kind: str, cell: object, buses: set[int]) -> bool:
    if kind == "bool":
        return isinstance(cell, bool | np.bool_)
    if isinstance(cell, bool | np.bool_) or not isinstance(cell, int | float | np.number):
        return False
    if kind == "bus":
        return cell == cell and cell in buses
    low, high = _limits(kind)
    return bool(low <= cell <= high)


def _check_index(source: str, name: str, index: Any) -> None:
    visited: set[int] = set()
    for i in index.tolist():
        if isinstance(i, bool) or not isinstance(i, int) or not 0 <= i <= LARGEST_INDEX:
            raise FeederError(f"{source}, table {name}: the index {i!r} is no whole number of 0 to {LARGEST_INDEX}")
        if i in visited:
            raise FeederError(f"{source}, table {name}: the index {i} is there twice")
        visited.add(i)


def _check_switches(source: str, net: PandapowerNet) -> None:
    table = net.switch
    end_columns = {"b": ("bus", ()), "l": ("line", ("from_bus", "to_bus")), "t": ("trafo", ("hv_bus", "lv_bus")),
          "t3": ("trafo3w", ("hv_bus", "mv_bus", "lv_bus"))}  # fmt: skip
    ends = {et: net[name][list(columns)].to_dict("index") for et, (name, columns) in end_columns.items()}
    for i, bus, element, et in zip(table.index, table.bus, table.element, table.et, strict=True):
        if et not in end_columns:
            raise FeederError(f"{source}, table switch, index {i}: et is empty; it is b, l, t or t3")
        if element not in ends[et]:
            raise FeederError(
                f"{source}, table switch, index {i}: element is {element!r}, no index of {end_columns[et][0]}"
            )
        if et != "b" and bus not in ends[et][element].values():
            text = f"bus is {bus!r}, at which {end_columns[et][0]} {element} does not end"
            raise FeederError(f"{source}, table switch, index {i}: {text}")


def _check_ends(source: str, net: PandapowerNet) -> None:
    for name, columns in (("line", ("from_bus", "to_bus")), ("trafo", ("hv_bus", "lv_bus"))):
        table = net[name]
        for i, a, b in zip(table.index, table[columns[0]], table[columns[1]], strict=True):
            if a == b:
                raise FeederError(
                    f"{source}, table {name}, index {i}: {columns[1]} is {b}, as {columns[0]}; give two buses"
                )
    for i, whole, real in zip(net.trafo.index, net.trafo.vk_percent, net.trafo.vkr_percent, strict=True):
        if real > whole:
            raise FeederError(
                f"{source}, table trafo, index {i}: vkr_percent is {real}, more than vk_percent, {whole}; it is part "
                "of that"
            )
