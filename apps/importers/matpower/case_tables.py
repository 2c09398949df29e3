"""The tables of a MATPOWER case file, read statement by statement; nothing is executed."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dcgrid_env.apps.importers.import_report import Report
from dcgrid_env.apps.importers.matpower.case_conversions import Conversions, number
from dcgrid_env.apps.importers.matpower.case_text import Statement, statements
from dcgrid_env.core.user_files import read_text
from dcgrid_env.grid.topology import FeederError

WIDTHS = {"bus": (13, 13), "gen": (10, 21), "branch": (11, 13), "dcline": (3, 17)}
"""Columns that a table must have, and those that are of the case rather than of a solution."""
_MOST_MIB = 256
_FUNCTION = re.compile(r"function\s+\w+\s*=\s*(\w+)(?:\s*\(\s*\))?\Z")
_FIELD = re.compile(r"mpc\.([A-Za-z]\w*(?:\.\w+)*)\s*=\s*(.*)\Z", re.DOTALL)


@dataclass
class CaseTables:
    """Contents of a case file, in MATPOWER's units.

    Attributes
    ----------
    name
        Name of its function.
    base_mva
        Base power, MVA.
    tables
        ``bus``, ``gen``, ``branch`` and, where there is one, ``dcline``, shape (row, column).
    lines
        Line of the file of each row of a table.
    bus_names
        Texts of ``mpc.bus_name``, empty where there are none.
    """

    name: str
    base_mva: float
    tables: dict[str, np.ndarray]
    lines: dict[str, list[int]] = field(default_factory=dict)
    bus_names: tuple[str, ...] = ()


def case_text(path: Path) -> str:
    """Text of a file; FeederError where it cannot be read."""
    try:
        return read_text(path, FeederError, _MOST_MIB)
    except OSError as error:
        raise FeederError(f"{path} cannot be read ({error.strerror}); give a MATPOWER case file") from None


def case_tables(file: str, text: str, report: Report) -> CaseTables:
    """Read the text of a case file.

    Raises
    ------
    FeederError
        For code that is not read, a table that is missing or has a cell that is not a number, naming file, line,
        table and column.
    """
    return _Reading(file, report).read(text)


class _Reading:
    def __init__(self, file: str, report: Report) -> None:
        self.file, self.report = file, report
        self.name, self.version, self.base_mva = "", "", math.nan
        self.tables: dict[str, np.ndarray] = {}
        self.lines: dict[str, list[int]] = {}
        self.bus_names: tuple[str, ...] = ()
        self.conversions = Conversions(file, self.tables)

    def read(self, text: str) -> CaseTables:
        for statement in statements(self.file, text):
            self._statement(statement)
        if self.version != "2":
            version_text = f"is of version {self.version}" if self.version else "names no version"
            raise FeederError(f"{self.file}: the case {version_text}; mpc.version = '2' is read: save it by savecase")
        if math.isnan(self.base_mva):
            raise FeederError(f"{self.file}: mpc.baseMVA is missing; give the base power in MVA")
        for table in ("bus", "gen", "branch"):
            if table not in self.tables:
                raise FeederError(f"{self.file}: mpc.{table} is missing; a case has mpc.bus, mpc.gen and mpc.branch")
        return CaseTables(self.name, self.base_mva, self.tables, self.lines, self.bus_names)

    def _statement(self, statement: Statement) -> None:
        line, text = statement.line, statement.text
        function = _FUNCTION.match(text)
        if function and not self.name:
            self.name = function[1]
            return
        if not self.name:
            raise FeederError(f"{self.file}, line {line}: a case begins with `function mpc = NAME`")
        if text in ("end", "return", "endfunction"):
            return
        assigned = _FIELD.match(text)
        if not assigned:
            if done := self.conversions.apply(line, text, self.base_mva):
                self.report.add("taken", "code", f"line {line}", done)
            return
        name, value = assigned[1], assigned[2].strip()
        if name == "version":
            self.version = value.strip("'\"")
        elif name == "baseMVA":
            self.base_mva = self._base_mva(line, value)
        elif name in WIDTHS:
            self._table(line, name, text, value)
        elif name == "bus_name":
            self.bus_names = self._texts(line, text, value)
        else:
            self.report.add("nothing lost", "field", f"mpc.{name}", "the power flow has no use for it")

    def _base_mva(self, line: int, text: str) -> float:
        try:
            value = number(text)
        except ValueError:
            raise self.conversions.refused(line, f"mpc.baseMVA = {text}") from None
        if not 0 < value < 1e12:
            raise FeederError(f"{self.file}, line {line}: mpc.baseMVA is {value:g}; give a positive number of MVA")
        return value

    def _table(self, line: int, name: str, text: str, value: str) -> None:
        if not (value.startswith("[") and value.endswith("]")):
            raise self.conversions.refused(line, text, "a table is a list of numbers in [ ]")
        if name in self.tables:
            raise FeederError(f"{self.file}, line {line}: mpc.{name} is there twice; leave one out")
        least, most = WIDTHS[name]
        rows: list[list[float]] = []
        lines: list[int] = []
        line += text[: text.index("[")].count("\n")
        for place, content in enumerate(value[1:-1].split("\n"), line):
            for row in content.split(";"):
                cells = row.replace(",", " ").split()
                if cells:
                    rows.append([self._cell(place, name, k, cell) for k, cell in enumerate(cells, 1)])
                    lines.append(place)
        for place, row in zip(lines, rows, strict=True):
            if len(row) != len(rows[0]):
                raise FeederError(
                    f"{self.file}, line {place}: mpc.{name} has {len(row)} cells here and {len(rows[0])} before"
                )
            if len(row) < least:
                raise FeederError(
                    f"{self.file}, line {place}: mpc.{name} has {len(row)} columns; it has {least} or more"
                )
        if rows and len(rows[0]) > most:
            self.report.add("nothing lost", "column", f"mpc.{name}", f"what stands beyond column {most} is left out")
        self.tables[name] = np.array([row[:most] for row in rows]).reshape(len(rows), -1 if rows else least)
        self.lines[name] = lines

    def _cell(self, line: int, table: str, column: int, cell: str) -> float:
        """A cell as a number; FeederError for one that is not."""
        try:
            return number(cell)
        except ValueError:
            where = f"{self.file}, line {line}: mpc.{table}, column {column}"
            raise FeederError(f"{where} is {cell[:60]!r}; give a number") from None

    def _texts(self, line: int, text: str, value: str) -> tuple[str, ...]:
        if not (value.startswith("{") and value.endswith("}")):
            raise self.conversions.refused(line, text, "names are texts in { }")
        return tuple(one.replace("''", "'") for one in re.findall(r"'((?:[^'\n]|'')*)'", value))
