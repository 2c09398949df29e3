"""The tables of a MATPOWER case file: every statement is looked at, and figures are parsed by matpowercaseframes."""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dcgrid_env.core.install import from_clone
from dcgrid_env.grid.formats.import_report import Report
from dcgrid_env.grid.formats.matpower.case_code import CaseCode
from dcgrid_env.grid.formats.matpower.case_text import Statement, statements
from dcgrid_env.grid.topology import FeederError

WIDTHS = {"bus": (13, 13), "gen": (10, 21), "branch": (11, 13), "dcline": (3, 17)}
"""Columns that a table must have, and those that are of the case rather than of a solution."""
_MAX_BYTES = 256 * 2**20
_NUMBER = re.compile(r"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?|[iI]nf|NaN|nan)\Z")
_FUNCTION = re.compile(r"function\s+\w+\s*=\s*(\w+)(?:\s*\(\s*\))?\Z")
_FIELD = re.compile(r"mpc\.([A-Za-z]\w*(?:\.\w+)*)\s*=\s*(.*)\Z", re.DOTALL)


@dataclass
class CaseTables:
    """What a case file holds, after what its own code makes of it.

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
        if path.stat().st_size > _MAX_BYTES:
            raise FeederError(f"{path} has more than {_MAX_BYTES // 2**20} MiB; give a case file")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FeederError(f"{path}: {error}; save it as UTF-8") from None
    except OSError as error:
        raise FeederError(f"{path} cannot be read ({error.strerror}); give a MATPOWER case file") from None


def case_tables(file: str, text: str, report: Report) -> CaseTables:
    """Read the text of a case file.

    Raises
    ------
    FeederError
        For code that is not known, a table that is missing or has a cell that is no number, naming file, line, table
        and column; where matpowercaseframes is missing.
    """
    return _Reading(file, report).read(text)


class _Reading:
    def __init__(self, file: str, report: Report) -> None:
        self.file, self.report, self.code = file, report, CaseCode(file)
        self.name, self.version = "", ""
        self.lines: dict[str, list[int]] = {}
        self.bus_names: tuple[str, ...] = ()
        self.changed = False

    def read(self, text: str) -> CaseTables:
        for statement in statements(self.file, text):
            self._statement(statement)
        if self.version != "2":
            what = f"is of version {self.version}" if self.version else "names no version"
            raise FeederError(f"{self.file}: the case {what}; mpc.version = '2' is read: save it by savecase")
        if "mpc.baseMVA" not in self.code.scalars:
            raise FeederError(f"{self.file}: mpc.baseMVA is missing; give the base power in MVA")
        for table in ("bus", "gen", "branch"):
            if table not in self.code.tables:
                raise FeederError(f"{self.file}: mpc.{table} is missing; a case has mpc.bus, mpc.gen and mpc.branch")
        base_mva = self.code.scalars["mpc.baseMVA"]
        if not 0 < base_mva < 1e12:
            raise FeederError(f"{self.file}: mpc.baseMVA is {base_mva:g}; give a positive number of MVA")
        if self.changed:
            self.report.add(
                "taken", "code", self.name, "its own arithmetic on its tables, such as ohms to p.u., is done"
            )
        tables = {name: self.code.tables[name] for name in WIDTHS if name in self.code.tables}
        return CaseTables(self.name, base_mva, tables, self.lines, self.bus_names)

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
            self.code.run(line, text)
            self.changed |= text.startswith("mpc.")
            return
        name, value = assigned[1], assigned[2].strip()
        if name == "version":
            self.version = value.strip("'\"")
        elif name == "baseMVA":
            self.code.scalars["mpc.baseMVA"] = self.code.scalar(line, value)
        elif name in WIDTHS:
            self._table(line, name, text, value)
        elif name == "bus_name":
            self.bus_names = self._texts(line, text, value)
        else:
            self.report.add("nothing lost", "field", f"mpc.{name}", "the power flow has no use for it")

    def _table(self, line: int, name: str, text: str, value: str) -> None:
        if not (value.startswith("[") and value.endswith("]")):
            raise self.code.refused(line, text, "a table is a list of numbers in [ ]")
        if name in self.code.tables:
            raise FeederError(f"{self.file}, line {line}: mpc.{name} is there twice; leave one out")
        least, most = WIDTHS[name]
        rows: list[list[str]] = []
        lines: list[int] = []
        line += text[: text.index("[")].count("\n")
        for number, content in enumerate(value[1:-1].split("\n"), line):
            for row in content.split(";"):
                cells = row.replace(",", " ").split()
                if cells:
                    rows.append([self._cell(number, name, k, cell) for k, cell in enumerate(cells, 1)])
                    lines.append(number)
        for number, row in zip(lines, rows, strict=True):
            if len(row) != len(rows[0]):
                raise FeederError(
                    f"{self.file}, line {number}: mpc.{name} has {len(row)} cells here and {len(rows[0])} before"
                )
            if len(row) < least:
                raise FeederError(
                    f"{self.file}, line {number}: mpc.{name} has {len(row)} columns; it has {least} or more"
                )
        if rows and len(rows[0]) > most:
            self.report.add("nothing lost", "column", f"mpc.{name}", f"what stands beyond column {most} is left out")
        self.code.tables[name] = parsed(name, [row[:most] for row in rows])
        self.lines[name] = lines

    def _cell(self, line: int, table: str, column: int, cell: str) -> str:
        """A cell as a number that every reader takes; FeederError for what is none."""
        if _NUMBER.match(cell):
            return cell.replace("d", "e").replace("D", "e")
        try:
            return repr(self.code.scalar(line, cell))
        except FeederError:
            where = f"{self.file}, line {line}: mpc.{table}, column {column}"
            raise FeederError(f"{where} is {cell[:60]!r}; give a number") from None

    def _texts(self, line: int, text: str, value: str) -> tuple[str, ...]:
        if not (value.startswith("{") and value.endswith("}")):
            raise self.code.refused(line, text, "names are texts in { }")
        return tuple(one.replace("''", "'") for one in re.findall(r"'((?:[^'\n]|'')*)'", value))


def parsed(name: str, rows: list[list[str]]) -> np.ndarray:
    """Cells of a table as numbers, shape (row, column), by matpowercaseframes; FeederError where that is missing."""
    if not rows:
        return np.zeros((0, WIDTHS[name][0]))
    try:
        from matpowercaseframes import CaseFrames
    except ImportError:
        raise FeederError(
            f"matpowercaseframes is missing, which parses MATPOWER's tables; {from_clone('matpower')}"
        ) from None
    body = ";\n".join("\t".join(row) for row in rows)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "table.m"
        file.write_text(f"function mpc = table\nmpc.{name} = [\n{body};\n];\n", encoding="utf-8")
        frame = getattr(CaseFrames(str(file), update_index=False), name)
    return np.array(frame.to_numpy(), dtype=np.float64)
