"""Text files of cells in any usual dialect, read as plain lines with a comma between cells and a decimal point.

Exports of spreadsheets and dashboards use quotes around every cell, semicolons or tabs between cells, and decimal
commas. Readers get the same lines for all of them, with the numbers of the lines unchanged.
"""

import csv
import io
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from typing import NamedTuple

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
        return self._dialect.plain(line, self.line)

    def blocks(self) -> Iterator[Block]:
        """All further lines, in blocks."""
        top = Block(self.line + 1, "".join(self._top))
        self._top = []
        for block in chain([top] if top.text else [], self._file.blocks()):
            plain = Block(block.first_line, self._dialect.plain(block.text, block.first_line))
            self.line = block.first_line + block.text.count("\n") - block.text.endswith("\n")
            yield plain
        self._dialect.require_decimals()

    def sha256(self) -> str:
        """SHA-256 of the file's bytes as they are stored, hexadecimal."""
        return self._file.sha256()


@contextmanager
def open_table(path: str | os.PathLike[str], delimiter: str | None = None) -> Iterator[TableFile]:
    """Open a text file of cells; `open_text` defines the encodings, and `delimiter` is found if it is None.

    Raises TraceError for a file with decimal points and decimal commas, or with a comma that may be either.
    """
    with open_text(path) as file:
        yield TableFile(file, delimiter)


def _top(file: TextFile) -> Iterator[str]:
    """Yield lines until some have content."""
    lines = characters = 0
    while lines < _SHOWING_LINES and characters < _SHOWING_CHARS and (line := file.readline()):
        lines += bool(line.strip()) and not line.startswith("#")
        characters += len(line)
        yield line


class _Column(NamedTuple):
    """Numbers of a column that show its decimal sign: the line and text of the first of each kind."""

    comma: tuple[int, str] | None = None
    point: tuple[int, str] | None = None
    certain: bool = False
    """Whether a sign cannot be a thousands separator, as other than three digits follow it."""
    whole: bool = False
    """Whether there are whole numbers below 1000."""


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
        self._columns: dict[int, _Column] = {}

    def plain(self, text: str, first_line: int) -> str:
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
            cells = [self._decimal(cell, column, number) for column, cell in enumerate(cells)]
        joined = ",".join(cells)
        if joined.count(",") >= len(cells) or '"' in joined:
            out = io.StringIO()
            csv.writer(out, lineterminator="").writerow(cells)
            joined = out.getvalue()
        return joined + line[len(content) :]

    def _decimal(self, cell: str, column: int, number: int) -> str:
        """Return a number with a decimal point; raise TraceError if its column has both signs."""
        match = _NUMBER.fullmatch(cell)
        if match is None:
            return cell
        found, shown, sign = self._columns.get(column, _Column()), (number, cell.strip()), match["sign"]
        digits = match["digits"]
        if sign is None:
            self._columns[column] = found._replace(whole=found.whole or len(digits) <= 3)
            return cell
        certain = found.certain or len(match["decimals"]) != 3 or len(digits) > 3 or digits.startswith("0")
        if sign == ",":
            found = found._replace(comma=found.comma or shown, certain=certain)
            cell = cell.replace(",", ".")
        else:
            found = found._replace(point=found.point or shown, certain=certain)
        if found.comma and found.point:
            raise TraceError(
                f"{self._name}, line {number}: the column has {found.point[1]!r} in line {found.point[0]} and "
                f"{found.comma[1]!r} in line {found.comma[0]}; {_ONE_SIGN}"
            )
        self._columns[column] = found
        return cell

    def require_decimals(self) -> None:
        """Raise TraceError if the signs in the numbers of a column may separate thousands."""
        has_commas = any(column.comma for column in self._columns.values())
        for column in self._columns.values():
            shown = column.comma if column.whole else None
            if has_commas and column.point:
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
