"""Text files of cells in any usual dialect, read as plain lines with a comma between cells and a decimal point.

Exports of spreadsheets and dashboards use quotes around every cell, semicolons or tabs between cells, and decimal
commas. Readers get the same lines for all of them, with the numbers of the lines unchanged.
"""

import csv
import io
import os
import re
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain

from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.text.text_file import Block, TextFile, open_text

DELIMITERS = (";", "\t", ",")
"""Characters between cells that are recognised; a comma where the first lines show none of the others."""
_SHOWING_LINES = 6
_SHOWING_CHARS = 1 << 16
"""Lines and characters at the top of a file that show its dialect."""
_NUMBER = re.compile(
    r"\s*[-+]?(?P<digits>\d+)(?:(?P<sign>[.,])(?P<decimals>\d+))?(?:[eE][-+]?\d+)?(?:\s*[A-Za-z]{1,2})?\s*"
)
_THOUSANDS = re.compile(r"(?<![\w.])[1-9]\d{0,2}\.\d{3}(?![\w.])")
_EARLIER_LINES = 50
_NAME = re.compile(r"\s*\"?[A-Za-z_]")
_ONE_SIGN = "write all numbers with the same decimal sign and without thousands separators"
_SEPARATOR_LINE = re.compile(r'\s*"?sep=(.)"?\s*', re.DOTALL)
"""Line at the top of a file with which spreadsheets name the delimiter."""


class TableFile:
    """An open text file of cells, made by `open_table`; it has the methods of `TextFile`."""

    def __init__(self, file: TextFile, delimiter: str | None) -> None:
        self.name = file.name
        self.line = 0
        """Number of the last line handed out."""
        self._file = file
        self._top = list(_top(file))
        self._dialect = _Dialect(file.name, self._top, delimiter)

    def readline(self) -> str:
        """The next line with its line end, or an empty text at the end of the file."""
        line = self._top.pop(0) if self._top else self._file.readline()
        self.line += bool(line)
        if not line:
            self._dialect.require_decimals()
        return self._dialect.normalise(line, self.line)

    def blocks(self) -> Iterator[Block]:
        """All further lines, in blocks."""
        top = Block(self.line + 1, "".join(self._top))
        self._top = []
        for block in chain([top] if top.text else [], self._file.blocks()):
            normalised = Block(block.first_line, self._dialect.normalise(block.text, block.first_line))
            self.line = block.first_line + block.text.count("\n") - block.text.endswith("\n")
            yield normalised
        self._dialect.require_decimals()

    def sha256(self) -> str:
        """SHA-256 of the file's bytes as they are stored, hexadecimal."""
        return self._file.sha256()


@contextmanager
def open_table(
    path: str | os.PathLike[str], delimiter: str | None = None, *, most_mib: int | None = None
) -> Iterator[TableFile]:
    """Open a text file of cells; `open_text` defines the encodings and the limit of the size.

    `delimiter` is found if it is None.

    Raises TraceError for a file with decimal points and decimal commas, or with a comma that may be either.
    """
    with open_text(path, most_mib) as file:
        yield TableFile(file, delimiter)


def _top(file: TextFile) -> Iterator[str]:
    """Yield lines until some have content."""
    lines = characters = 0
    while lines < _SHOWING_LINES and characters < _SHOWING_CHARS and (line := file.readline()):
        lines += bool(line.strip()) and not line.startswith("#")
        characters += len(line)
        yield line


@dataclass(slots=True)
class _Column:
    """Numbers of a column that show its decimal sign: the line and text of the first of each kind."""

    comma: tuple[int, str] | None = None
    point: tuple[int, str] | None = None
    certain: bool = False
    """Whether a sign cannot be a thousands separator, as other than three digits follow it."""
    whole: int = -1
    """Largest whole number below 1000; -1 if there is none."""


class _Dialect:
    """Delimiter of a file, and the decimal signs that its numbers had so far."""

    def __init__(self, name: str, top: list[str], delimiter: str | None) -> None:
        self._name = name
        shown = [line for line in top if line.strip() and not line.startswith("#")]
        self._is_table = not (shown and shown[0].lstrip().startswith(("{", "[")))
        """Whether the lines are cells, and not JSON."""
        stated = _SEPARATOR_LINE.fullmatch(shown[0]) if shown else None
        if stated:
            top[top.index(shown[0])] = "\n"
            shown = shown[1:]
        self.delimiter = delimiter or (stated[1] if stated else _found_delimiter(shown))
        names = shown[0].split(self.delimiter) if shown else []
        self._header = 1 + top.index(shown[0]) if any(map(_NAME.match, names)) else 0
        """Number of the line with the names of the columns; 0 if there is none."""
        self._columns: defaultdict[int, _Column] = defaultdict(_Column)
        self._earlier: list[tuple[int, list[str]]] = []
        """Lines before the first with a comma, by which its commas are judged: the first ones, and those with a sign
        that may separate thousands."""
        self._has_commas = False

    def normalise(self, text: str, first_line: int) -> str:
        """Return lines with commas between cells, a decimal point, and quotes only where a cell needs them."""
        if not self._is_table or ('"' not in text and (self.delimiter == "," or self.delimiter not in text)):
            return text
        return "".join(self._line(line, number) for number, line in enumerate(text.splitlines(True), first_line))

    def _line(self, line: str, number: int) -> str:
        content = line.rstrip("\n")
        if line.startswith("#") or content.count('"') % 2 or (self.delimiter == "," and '"' not in content):
            return line
        if '"' in content:
            cells = next(csv.reader([content], delimiter=self.delimiter, skipinitialspace=True))
        else:
            cells = content.split(self.delimiter)
        if self.delimiter != "," and number != self._header:
            if self._has_commas or "," in content:
                for earlier, others in self._earlier:
                    self._decimals(others, earlier)
                self._earlier, self._has_commas = [], True
                cells = self._decimals(cells, number)
            elif len(self._earlier) < _EARLIER_LINES or _THOUSANDS.search(content):
                self._earlier = [*self._earlier[: 2 * _EARLIER_LINES], (number, cells)]
        joined = ",".join(cells)
        if joined.count(",") >= len(cells) or '"' in joined:
            out = io.StringIO()
            csv.writer(out, lineterminator="").writerow(cells)
            joined = out.getvalue()
        return joined + line[len(content) :]

    def _decimals(self, cells: list[str], number: int) -> list[str]:
        """Return cells with decimal points; raise TraceError if a column has both signs."""
        with_points = []
        for index, cell in enumerate(cells):
            match = _NUMBER.fullmatch(cell)
            if match is not None:
                column, sign, digits = self._columns[index], match["sign"], match["digits"]
                if sign is None:
                    column.whole = max(column.whole, int(digits) if len(digits) <= 3 else -1)
                else:
                    if not column.certain:
                        column.certain = len(match["decimals"]) != 3 or len(digits) > 3 or digits.startswith("0")
                    if sign == ",":
                        column.comma = column.comma or (number, cell.strip())
                        cell = cell.replace(",", ".")
                    else:
                        column.point = column.point or (number, cell.strip())
                    if column.comma and column.point:
                        raise TraceError(
                            f"{self._name}, line {number}: the column has {column.point[1]!r} in line "
                            f"{column.point[0]} and {column.comma[1]!r} in line {column.comma[0]}; {_ONE_SIGN}"
                        )
            with_points.append(cell)
        return with_points

    def require_decimals(self) -> None:
        """Raise TraceError if the signs in the numbers of a column may separate thousands."""
        if not self._has_commas and any(_THOUSANDS.search(cell) for _, cells in self._earlier for cell in cells):
            for number, cells in self._earlier:
                self._decimals(cells, number)
        has_commas = any(column.comma for column in self._columns.values())
        for column in self._columns.values():
            shown = column.comma if column.whole >= 0 else None
            if column.point and (has_commas or column.whole > 0):
                shown = column.point
            if shown and not column.certain:
                number, text = shown
                raise TraceError(
                    f"{self._name}, line {number}: the sign in {text!r} may be a decimal sign or separate thousands; "
                    f"{_ONE_SIGN}"
                )


def _found_delimiter(lines: list[str]) -> str:
    """Return the delimiter that gives all lines the same number of cells, at least two."""
    for delimiter in DELIMITERS:
        whole = [line for line in lines if line.count('"') % 2 == 0]
        widths = {len(next(csv.reader([line], delimiter=delimiter))) for line in whole}
        if len(widths) == 1 and widths != {1} and not (delimiter == "\t" and any(",\t" in line for line in lines)):
            return delimiter
    first = lines[0] if lines else ""
    return max(reversed(DELIMITERS), key=first.count)
