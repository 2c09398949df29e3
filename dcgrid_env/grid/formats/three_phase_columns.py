"""Which columns the tables of a three-phase feeder have in their files, and what one cell or several of them make."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dcgrid_env.grid.network import (
    AdmittanceTable,
    CapacitorControlTable,
    CapacitorTable,
    CoreTable,
    PhaseLineTable,
    PhaseLoadTable,
    RegulatorTable,
    SwitchTable,
    TransformerTable,
)
from dcgrid_env.grid.three_phase_tables import FALLBACKS

_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_TEXTS = ("name", "bank", "bus", "from_bus", "to_bus", "phases", "state", "connection", "connection_from")
_TEXTS += ("connection_to", "model", "sensed_phase", "kind", "nodes", "capacitor", "measures", "legs", "legs_of")
_TEXTS += ("phases_of", "after", "sensed_bus")
_MAY_BE_NAN = ("low_v", "high_v", "least_kvar")
_UNKNOWN = ("length_m", *_MAY_BE_NAN, *FALLBACKS)
_WHOLE = ("tap", "tap_neutral", "tap_min", "tap_max", "max_taps_per_move", "is_fixed")


def says_nothing(column: str, columns: Mapping[str, Sequence[Any]]) -> bool:
    """Whether a column may be left out: of ratings if it is empty, all unknown, or equal to the column that counts.

    The connection of regulators may be left out if all are wye.
    """
    if column == "connection" and "pt_ratio" in columns:
        return all(value == "wye" for value in columns[column])
    if column in ("exponents", "after", "sensed_bus", "z_ldc_v", "is_fixed"):
        return not any(columns[column])
    if column in _MAY_BE_NAN:
        return all(map(math.isnan, columns[column]))
    if column not in FALLBACKS:
        return False
    values, instead = columns[column], FALLBACKS[column]
    return not values or (all(map(math.isnan, values)) if instead is None else values == columns[instead])


@dataclass(frozen=True)
class Column:
    """A column of a table: the names that it has in its file, and how cells become its value."""

    field: str
    names: tuple[str, ...]
    shape: str = "one"
    """``one`` cell, the upper triangle of a ``matrix``, three ``legs``, the shares of a ``zip`` or the exponents of a
    load, which other models lack, or any ``list``."""
    if_missing: str | None = None
    """The text of a cell where the file lacks the column; None if it may not, or is a rating."""

    @property
    def is_text(self) -> bool:
        """Whether a cell is a text and no number."""
        return self.field in _TEXTS

    @property
    def is_whole(self) -> bool:
        """Whether a cell is a whole number."""
        return self.field in _WHOLE

    @property
    def may_be_empty(self) -> bool:
        """Whether a cell may be empty: a phase that does not exist, an unknown length, a model without shares."""
        return self.shape in ("matrix", "zip") or self.field in _UNKNOWN or self.if_missing == ""

    @property
    def may_be_missing(self) -> bool:
        """Whether the file may lack the column."""
        return self.shape == "zip" or self.field in _UNKNOWN or self.if_missing is not None

    def joined(self, cells: Sequence[Any]) -> Any:
        """The value that cells make."""
        if self.shape == "matrix":
            by_position = dict(zip(_UPPER, cells, strict=True))
            return tuple(tuple(by_position[min(i, j), max(i, j)] for j in range(3)) for i in range(3))
        if self.shape == "zip":
            return () if all(math.isnan(cell) for cell in cells) else tuple(cells)
        return tuple(cells) if self.shape in ("legs", "list") else cells[0]

    def cells(self, value: Any) -> Sequence[Any]:
        """The cells that a value becomes."""
        if self.shape == "matrix":
            return [value[i][j] for i, j in _UPPER]
        if self.shape == "zip":
            return value or (math.nan,) * len(self.names)
        if self.shape == "list":
            return (" ".join(repr(float(figure)) for figure in value),)
        return value if self.shape == "legs" else (value,)


@dataclass(frozen=True)
class File:
    """A file, its columns and the table that it is."""

    name: str
    table: type[Any]
    columns: tuple[Column, ...]


def _matrix(quantity: str, unit: str) -> Column:
    entries = (f"{quantity}_{'abc'[i]}{'abc'[j]}_{unit}" for i, j in _UPPER)
    return Column(f"{quantity}_{unit}", tuple(entries), "matrix")


_SPECIAL = {
    ("phase_line", "r_ohm"): _matrix("r", "ohm"),
    ("phase_line", "x_ohm"): _matrix("x", "ohm"),
    ("phase_line", "b_us"): _matrix("b", "us"),
    ("phase_load", "p_kw"): Column("p_kw", ("kw_1", "kw_2", "kw_3"), "legs"),
    ("phase_load", "q_kvar"): Column("q_kvar", ("kvar_1", "kvar_2", "kvar_3"), "legs"),
    ("phase_load", "zip"): Column("zip", ("zip_pz", "zip_pi", "zip_pp", "zip_qz", "zip_qi", "zip_qp"), "zip"),
    ("phase_load", "exponents"): Column("exponents", ("exponent_p", "exponent_q"), "zip"),
    ("core", "p_kw"): Column("p_kw", ("kw_1", "kw_2", "kw_3"), "legs"),
    ("core", "q_kvar"): Column("q_kvar", ("kvar_1", "kvar_2", "kvar_3"), "legs"),
    ("capacitor", "kvar"): Column("kvar", ("kvar_a", "kvar_b", "kvar_c"), "legs"),
    ("capacitor", "is_fixed"): Column("is_fixed", ("is_fixed",), if_missing="0"),
    ("regulator", "connection"): Column("connection", ("connection",), if_missing="wye"),
    ("regulator", "sensed_bus"): Column("sensed_bus", ("sensed_bus",), if_missing=""),
    ("regulator", "z_ldc_v"): Column("z_ldc_v", ("z_ldc_v",), if_missing="0"),
    **{("capacitor_control", name): Column(name, (name,), if_missing="") for name in ("from_bus", "to_bus", "after")},
    ("admittance", "g_s"): Column("g_s", ("g_s",), "list"),
    ("admittance", "b_s"): Column("b_s", ("b_s",), "list"),
}


def _file(name: str, kind: str, table: type[Any]) -> File:
    fields = [field.name for field in dataclasses.fields(table)]
    return File(name, table, tuple(_SPECIAL.get((kind, field), Column(field, (field,))) for field in fields))


FILES = {
    "phase_line": _file("lines.csv", "phase_line", PhaseLineTable),
    "switch": _file("switches.csv", "switch", SwitchTable),
    "transformer": _file("transformers.csv", "transformer", TransformerTable),
    "regulator": _file("regulators.csv", "regulator", RegulatorTable),
    "phase_load": _file("loads.csv", "phase_load", PhaseLoadTable),
    "capacitor": _file("capacitors.csv", "capacitor", CapacitorTable),
    "capacitor_control": _file("capacitor_controls.csv", "capacitor_control", CapacitorControlTable),
    "core": _file("cores.csv", "core", CoreTable),
    "admittance": _file("admittances.csv", "admittance", AdmittanceTable),
}
"""Files of a folder other than feeder.toml and buses.csv, by table of ``Network``."""
