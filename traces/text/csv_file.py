"""Reading a power trace from a text file of any size, with errors that name the line and the column."""

import csv
import io
import json
import os
import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, check_samples, require_positive
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.text.gaps import GapRule
from dcgrid_env.traces.text.power_unit import KW_PER_UNIT, bracketed, column_unit, last_word, require_unit
from dcgrid_env.traces.text.text_file import Block, TextFile, open_text

RECORDED = "# dcgrid trace "
"""Begins the first line of a recorder's file; a JSON object follows."""
SECONDS = re.compile(r"s(?:ec(?:ond)?s?)?")
NOT_SECONDS = re.compile(
    r"[nu\u03bcm]s(?:ec)?|(?:nano|micro|milli)s(?:ec(?:ond)?s?)?|m(?:in(?:ute)?s?)?|h(?:(?:ou)?rs?)?|d(?:ays?)?"
)
"""Other units of time, as `casefold` leaves them."""

Column = int | str


@dataclass(frozen=True)
class _Layout:
    """Which cells of a line count, and what they mean."""

    delimiter: str
    width: int
    columns: list[int]
    """Indices, the time first."""
    fields: list[str]
    """What messages call them."""
    kw: FloatArray
    """kW for 1 in each power column, (n_power,)."""
    first_line: int

    @property
    def blank(self) -> str:
        """Characters of a line without content."""
        return f' \t\n"{self.delimiter}'


def read_csv(
    path: str | os.PathLike[str],
    time_column: Column = 0,
    power_columns: Sequence[Column] | None = None,
    unit: str | None = None,
    header: bool | None = None,
    delimiter: str = ",",
    *,
    max_gap_s: float | None = None,
    gaps: str = "error",
    limit_kw: float = 1e6,
) -> tuple[FloatArray, FloatArray, Provenance]:
    """Read times and the sum of the power columns, with 16 bytes of memory for each line and a few MB of text.

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip, one sample on each line. Empty lines are skipped, and so are lines at the
        top that begin with `#`. The JSON object after `# dcgrid trace ` in the first line goes to the provenance.
    time_column : index from 0 or header name; times in s. A name with another unit (`time_ms`, `t [h]`) is refused.
    power_columns : indices or header names, summed; by default every column but the time (one for each GPU).
    unit : of the power columns: "W", "kW", "MW" or "mW"; by default what their names end in, for example `site [kW]`,
        `power (MW)`, `P/kW`, `gpu0_w`. Names without a unit are refused. A file without header is in W by default, as
        the published recordings are.
    header : whether the first line contains names; by default it does if none of its cells is a number.
    delimiter : character between cells.
    max_gap_s, gaps : rule for samples that are more than max_gap_s apart, see `dcgrid_env.traces.text.gaps.GapRule`;
        by default every distance is accepted.
    limit_kw : highest accepted power of one cell, kW; the default is 1 GW.

    Returns
    -------
    time_s, power_kw : (n,) float64 each
    provenance : the file's name and hash, and its recorder's notes

    Raises
    ------
    TraceError
        If the file is empty or unreadable, or a unit is unknown, contradicted or missing. If there is an unknown
        column, a text cell, a missing cell, an invalid sample, power above the limit, or a gap. The message contains
        the file and, if there is one, the line.
    """
    rule = GapRule(max_gap_s, gaps)
    limit_kw = require_positive(limit_kw, "limit_kw", "give the highest power of one cell in kW")
    if len(delimiter) != 1:
        raise TraceError(f"delimiter = {delimiter!r} is not one character; give the one between cells")
    with open_text(path) as file:
        require_unit(file.name, unit)
        parameters, row, first = _first_row(file, delimiter)
        has_header = header if header is not None else not any(_is_number(cell) for cell in row)
        layout = _layout(file, row, has_header, time_column, power_columns, unit, delimiter)
        samples = _Samples(file.name, layout, rule, limit_kw)
        for block in file.blocks() if has_header else chain([first], file.blocks()):
            samples.add(block)
        provenance = Provenance(file.name, parameters=parameters, sha256=file.sha256())
    n = len(samples.time_s)
    if n < 2:
        raise TraceError(f"{file.name}: has {n} samples; give at least 2 (a sample holds until the next)")
    return np.frombuffer(samples.time_s), np.frombuffer(samples.power_kw), provenance


class _Samples:
    """Times and summed power of the blocks so far, and the last row for checks across their borders."""

    def __init__(self, name: str, layout: _Layout, rule: GapRule, limit_kw: float) -> None:
        self.time_s, self.power_kw = array("d"), array("d")
        self._name, self._layout, self._rule, self._limit_kw = name, layout, rule, limit_kw
        self._last = np.empty((0, len(layout.columns)))

    def add(self, block: Block) -> None:
        """Check and append the samples of a block."""
        layout = self._layout
        table = _numbers(block, layout)
        if table is None:
            table = _careful_numbers(self._name, block, layout)
        if not len(table):
            return
        n_before = len(self._last)
        table = np.concatenate([self._last, table])

        def where(i: int) -> str:
            return f"{self._name}, line {block.line_of(i - n_before, layout.blank)}"

        check_samples(table[:, 0], table[:, 1:], where, layout.fields[0], layout.fields[1:])
        power_kw = table[:, 1:] * layout.kw
        high = np.argwhere(power_kw > self._limit_kw)
        if high.size:
            i, j = high[0]
            raise TraceError(
                f"{where(i)}: {layout.fields[1 + j]} is {table[i, 1 + j]:g}, which is {power_kw[i, j]:g} kW and above "
                f"limit_kw = {self._limit_kw:g}; is the unit right? If so, raise limit_kw"
            )
        time_s, total_kw = self._rule.apply(table[:, 0], power_kw.sum(axis=1), where)
        self.time_s.frombytes(time_s[n_before:].tobytes())
        self.power_kw.frombytes(total_kw[n_before:].tobytes())
        self._last = table[-1:]


def _numbers(block: Block, layout: _Layout) -> FloatArray | None:
    """The chosen cells, (n, n_chosen); None for a block that needs a closer look, for an error or for odd cells."""
    text, width = block.text, layout.width
    if '"' in text or text.isspace():
        return None
    everything = layout.columns == list(range(width))
    if not everything and any(line.count(layout.delimiter) != width - 1 for _, line in block.lines()):
        return None
    columns = None if everything else layout.columns
    try:
        table = np.loadtxt(io.StringIO(text), delimiter=layout.delimiter, comments=None, usecols=columns, ndmin=2)
    except ValueError:
        return None
    return table if table.shape[1] == len(layout.columns) else None


def _careful_numbers(name: str, block: Block, layout: _Layout) -> FloatArray:
    """The chosen cells, (n, n_chosen), read line by line; TraceError for the first that is not a number."""
    cells = array("d")
    for number, line in block.lines(layout.blank):
        row = next(csv.reader([line], delimiter=layout.delimiter)) if '"' in line else line.split(layout.delimiter)
        if line.count('"') % 2:
            raise TraceError(f"{name}, line {number}: a quoted cell does not end; repair the line")
        if len(row) != layout.width:
            raise TraceError(
                f"{name}, line {number}: has {len(row)} cells, the first line {layout.width}; repair the line"
            )
        for c, field in zip(layout.columns, layout.fields, strict=True):
            try:
                cells.append(float(row[c]))
            except ValueError:
                first = number == layout.first_line
                remedy = "pass header=True if this line holds names" if first else "repair the cell"
                raise TraceError(f"{name}, line {number}: {field} is {row[c][:40]!r}, not a number; {remedy}") from None
    return np.array(cells, dtype=np.float64).reshape(-1, len(layout.columns))


def _first_row(file: TextFile, delimiter: str) -> tuple[dict[str, Any], list[str], Block]:
    """What the recorder noted, and the first line with content as cells and as a block."""
    parameters: dict[str, Any] = {}
    for line in iter(file.readline, ""):
        if file.line == 1 and line.startswith(RECORDED):
            parameters = _noted(file.name, line)
        if not line.startswith("#") and line.strip(f' \t\n"{delimiter}'):
            first = Block(file.line, line)
            # A name in quotes may hold a line end, as spreadsheets write them; the reader then takes further lines.
            row = next(csv.reader(chain([line], iter(file.readline, "")), delimiter=delimiter))
            return parameters, row, first
    raise TraceError(f"{file.name}: is empty; give a file with a time column and at least one power column")


def _noted(name: str, line: str) -> dict[str, Any]:
    """The JSON object of a recorder's first line."""
    try:
        noted = json.loads(line.removeprefix(RECORDED))
    except ValueError as error:
        raise TraceError(f"{name}, line 1: what follows {RECORDED!r} is not JSON ({error}); repair it") from error
    if not isinstance(noted, dict):
        raise TraceError(f"{name}, line 1: what follows {RECORDED!r} is {noted!r}; give a JSON object")
    return noted


def _layout(
    file: TextFile, row: list[str], has_header: bool, time_column, power_columns, unit: str | None, delimiter: str
) -> _Layout:
    name, width = file.name, len(row)
    names = [cell.strip() for cell in row] if has_header else None
    columns = _choose(name, width, names, time_column, power_columns)
    units: list[str | None] = [unit] * (len(columns) - 1)
    if names is not None:
        where = f"{name}, line {file.line}"
        _require_seconds(where, names[columns[0]])
        units = [column_unit(where, names[c], unit) for c in columns[1:]]
        if None in units:
            column = names[columns[1 + units.index(None)]]
            raise TraceError(
                f"{where}: {column!r} names no unit of power; pass unit= (one of {', '.join(KW_PER_UNIT)}), write it "
                "into the name like 'site [kW]' or 'site_kw', or leave the column out with power_columns="
            )
    return _Layout(
        delimiter=delimiter,
        width=width,
        columns=columns,
        fields=[f"column {c}" if names is None else f"column {c} ({names[c]!r})" for c in columns],
        kw=np.array([KW_PER_UNIT[u or "W"] for u in units]),
        first_line=file.line,
    )


def _require_seconds(where: str, header: str) -> None:
    inside = bracketed(header)[0].casefold()
    unit_text = SECONDS.fullmatch(inside) or NOT_SECONDS.fullmatch(inside)
    if NOT_SECONDS.fullmatch(inside if unit_text else last_word(header).casefold()):
        raise TraceError(
            f"{where}: the time column {header!r} is not in seconds; convert it to s, or rename the column if it is"
        )


def _choose(name: str, width: int, names: list[str] | None, time_column: Column, power_columns) -> list[int]:
    """Indices of the chosen columns, the time first."""
    if width < 2:
        raise TraceError(
            f"{name}: has {width} column; a time and at least one power column are needed "
            "(pass delimiter= if the cells are not separated by commas)"
        )
    time = _index(name, width, names, time_column)
    if power_columns is None:
        return [time, *(c for c in range(width) if c != time)]
    if isinstance(power_columns, str) or not power_columns:
        raise TraceError(
            f"{name}: power_columns is {power_columns!r}; give a list of indices or names, or None for all"
        )
    columns = [time, *(_index(name, width, names, c) for c in power_columns)]
    if len(set(columns)) < len(columns):
        raise TraceError(f"{name}: a column stands twice in time {time_column!r} and power {list(power_columns)!r}")
    return columns


def _index(name: str, width: int, names: list[str] | None, column: Column) -> int:
    """Index of a column given by index or by header name."""
    if isinstance(column, str):
        if names is None:
            raise TraceError(f"{name}: column {column!r} is asked for by name, but there is no header; give an index")
        if names.count(column) != 1:
            fault = "unknown" if column not in names else "not unique"
            raise TraceError(f"{name}: column {column!r} is {fault}; the header holds {', '.join(names)}")
        return names.index(column)
    if not 0 <= column < width:
        raise TraceError(f"{name}: column {column} is unknown; columns are 0 to {width - 1}")
    return int(column)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
