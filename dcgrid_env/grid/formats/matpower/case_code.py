"""The arithmetic that some MATPOWER cases do on their own tables, such as ohms to per unit, without executing MATLAB.

Numbers, names of columns, ``mpc.TABLE(:, COLUMNS)``, + - * / ^ and a few functions are evaluated here. Everything
else is refused with its line.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from dcgrid_env.grid.topology import FeederError

_BUS = tuple(
    "BUS_I BUS_TYPE PD QD GS BS BUS_AREA VM VA BASE_KV ZONE VMAX VMIN LAM_P LAM_Q MU_VMAX MU_VMIN".split()  # noqa: SIM905
)
_BRANCH = tuple(
    "F_BUS T_BUS BR_R BR_X BR_B RATE_A RATE_B RATE_C TAP SHIFT BR_STATUS PF QF PT QT MU_SF MU_ST ANGMIN "  # noqa: SIM905
    "ANGMAX".split()
)
_GEN = ["GEN_BUS", "PG", "QG", "QMAX", "QMIN", "VG", "MBASE", "GEN_STATUS", "PMAX", "PMIN"]
_BUS_NUMBERS = [1, 2, 3, 4, *range(1, 18)]
_BRANCH_NUMBERS = [*range(1, 12), *range(14, 20), 12, 13, 20, 21]
_GEN_NUMBERS = [*range(1, 11), 22, 23, 24, 25, *range(11, 22)]
_OUTPUTS = {"idx_bus": _BUS_NUMBERS, "idx_brch": _BRANCH_NUMBERS, "idx_gen": _GEN_NUMBERS}
"""What MATPOWER's functions of these names return, output by output: numbers of columns, and of bus types."""
_CONSTANTS = (
    dict(zip(("PQ", "PV", "REF", "NONE", *_BUS), _BUS_NUMBERS, strict=True))
    | dict(zip(_BRANCH, _BRANCH_NUMBERS[:19], strict=True))
    | dict(zip(_GEN, range(1, 11), strict=True))
)
_FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "sqrt": np.sqrt, "sin": np.sin, "cos": np.cos, "tan": np.tan,
    "acos": np.arccos, "asin": np.arcsin, "atan": np.arctan, "abs": np.abs,
}  # fmt: skip
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?)|(?P<name>[A-Za-z]\w*(?:\.[A-Za-z]\w*)*)"
    r"|(?P<sign>\.[*/^]|[-+*/^(),:\[\]]))"
)
_DEEPEST = 50


class CaseCode:
    """Names and tables as the statements of a file leave them."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.tables: dict[str, np.ndarray] = {}
        """Tables of ``mpc`` by name, shape (row, column)."""
        self.scalars: dict[str, float] = {"pi": math.pi, "Inf": math.inf, "inf": math.inf, "NaN": math.nan}
        """Names and scalars of ``mpc``, such as ``mpc.baseMVA``."""

    def refused(self, line: int, text: str, why: str = "") -> FeederError:
        """The error for a statement that is not known."""
        shown = " ".join(text.split())
        shown = shown if len(shown) <= 80 else shown[:77] + "..."
        more = f" ({why})" if why else ""
        return FeederError(
            f"{self.file}, line {line}: the MATLAB code {shown!r} is not read{more}; case files are not executed: "
            "run it in MATPOWER and save the case by savecase"
        )

    def run(self, line: int, text: str) -> None:
        """Do what a statement says; FeederError for one that is not known."""
        if text == "define_constants":
            self.scalars |= {name: float(number) for name, number in _CONSTANTS.items()}
            return
        left, sign, right = text.partition("=")
        if not sign or right.startswith("=") or left.endswith(("~", "<", ">", "!")):
            raise self.refused(line, text)
        left, right = left.strip(), right.strip()
        try:
            with np.errstate(all="ignore"):
                self._assign(left, right)
        except _Unknown as error:
            raise self.refused(line, text, str(error)) from None

    def scalar(self, line: int, text: str) -> float:
        """Value of an expression that is one number; FeederError for another."""
        try:
            with np.errstate(all="ignore"):
                value = _Expression(self, text).value
        except _Unknown as error:
            raise self.refused(line, text, str(error)) from None
        if np.ndim(value):
            raise self.refused(line, text, "it is no single number")
        return float(value)

    def _assign(self, left: str, right: str) -> None:
        if right in _OUTPUTS and left.startswith("[") and left.endswith("]"):
            names = re.split(r"[\s,]+", left[1:-1].strip())
            if len(names) > len(_OUTPUTS[right]):
                raise _Unknown(f"{right} returns {len(_OUTPUTS[right])} values")
            self.scalars |= {name: float(n) for name, n in zip(names, _OUTPUTS[right], strict=False) if name != "~"}
        elif re.fullmatch(r"[A-Za-z]\w*", left):
            value = _Expression(self, right).value
            if np.ndim(value):
                raise _Unknown("it is no single number")
            self.scalars[left] = float(value)
        else:
            target = _Expression(self, left, target=True)
            value = _Expression(self, right).value
            if np.ndim(value) and np.shape(value) != np.shape(target.value):
                raise _Unknown(f"{np.shape(value)} figures for {np.shape(target.value)} cells")
            table, rows, columns = target.place or (None, None, None)
            if table is None:
                raise _Unknown("only columns of mpc's tables are changed")
            self.tables[table][rows, columns] = value


class _Unknown(Exception):
    """What an expression has that is not known."""


class _Expression:
    """An expression by recursive descent; ``value`` is a number or an array of a table's cells."""

    def __init__(self, code: CaseCode, text: str, *, target: bool = False) -> None:
        self.code, self.words, at = code, [], 0
        while at < len(text.rstrip()):
            match = _TOKEN.match(text, at)
            if not match:
                raise _Unknown(f"at {text[at:].strip()[:20]!r}")
            self.words.append((match.lastgroup, match.group().strip()))
            at = match.end()
        self.at = self.depth = 0
        self.place: tuple[str, Any, Any] | None = None
        """Table, rows and columns that the expression began with."""
        self.value = self._atom() if target else self._sum()
        if self.at < len(self.words):
            raise _Unknown(f"at {self.words[self.at][1]!r}")

    def _next(self) -> tuple[str | None, str]:
        if self.at >= len(self.words):
            raise _Unknown("it ends too early")
        self.at += 1
        return self.words[self.at - 1]

    def _is(self, *signs: str) -> bool:
        return self.at < len(self.words) and self.words[self.at] in [("sign", sign) for sign in signs]

    def _expect(self, sign: str) -> None:
        if not self._is(sign):
            raise _Unknown(f"{sign!r} is missing")
        self.at += 1

    def _sum(self) -> Any:
        self.depth += 1
        if self.depth > _DEEPEST:
            raise _Unknown("it is nested too deeply")
        value = self._product()
        while self._is("+", "-"):
            sign, other = self._next()[1], self._product()
            value = value + other if sign == "+" else value - other
        self.depth -= 1
        return value

    def _product(self) -> Any:
        value = self._signed()
        while self._is("*", "/", ".*", "./"):
            sign, other = self._next()[1], self._signed()
            if np.ndim(other) and (sign == "/" or (sign == "*" and np.ndim(value))):
                raise _Unknown("matrices are not multiplied or divided")
            if np.ndim(value) and np.ndim(other) and np.shape(value) != np.shape(other):
                raise _Unknown("the columns differ in number")
            value = value * other if "*" in sign else np.divide(value, other)
        return value

    def _signed(self) -> Any:
        sign = 1.0
        while self._is("+", "-"):
            sign = -sign if self._next()[1] == "-" else sign
        return sign * self._power()

    def _power(self) -> Any:
        value = self._atom()
        while self._is("^", ".^"):
            sign, other = self._next()[1], self._atom()
            if np.ndim(other) or (np.ndim(value) and sign == "^"):
                raise _Unknown("matrices have no powers")
            value = np.power(np.asarray(value, dtype=np.float64), other)
        return value

    def _atom(self) -> Any:
        kind, word = self._next()
        if kind == "number":
            return float(re.sub("[dD]", "e", word))
        if word == "(":
            value = self._sum()
            self._expect(")")
            return value
        if kind != "name":
            raise _Unknown(f"at {word!r}")
        if word in _FUNCTIONS:
            self._expect("(")
            value = self._sum()
            self._expect(")")
            return _FUNCTIONS[word](value)
        field = word.removeprefix("mpc.")
        if word != field and field in self.code.tables:
            return self._cells(field)
        if word in self.code.scalars:
            return self.code.scalars[word]
        raise _Unknown(f"{word} is not known")

    def _cells(self, table: str) -> Any:
        """Cells of a table: ``(:, COLUMNS)`` or ``(ROW, COLUMN)``."""
        cells = self.code.tables[table]
        self._expect("(")
        rows: Any = slice(None)
        if self._is(":"):
            self.at += 1
        else:
            rows = self._index(cells.shape[0], "row")
        self._expect(",")
        if self._is("["):
            self.at += 1
            columns: Any = []
            while not self._is("]"):
                columns.append(self._index(cells.shape[1], "column"))
                if self._is(","):
                    self.at += 1
            self.at += 1
        else:
            columns = self._index(cells.shape[1], "column")
        self._expect(")")
        self.place = (table, rows, columns)
        return (
            cells[rows, columns].copy()
            if isinstance(rows, slice) or isinstance(columns, list)
            else cells[rows, columns]
        )

    def _index(self, n: int, what: str) -> int:
        value = self._atom()
        if np.ndim(value) or not 1 <= value <= n or value != int(value):
            raise _Unknown(f"{what} {value} of {n}")
        return int(value) - 1
