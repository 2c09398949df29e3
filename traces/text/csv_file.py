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
from typing import Any, NamedTuple

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

SHARE = "share"
"""Unit of power as a share of a rating."""
HIGHEST_SHARE = 2.0
INVALID_RULES = ("error", "drop")
_NO_READING = ("", "na", "n/a", "nan", "none", "null", "-")
"""Texts of a cell without a reading, in small letters."""

Column = int | str


class CsvSamples(NamedTuple):
    """Samples of a file."""

    time_s: FloatArray
    """(n,) float64."""
    power_kw: FloatArray
    """(n,) float64, kW, or shares of a rating of 1 kW."""
    rated_kw: float | None
    """Rating that the recorder noted, kW; 1 for shares, and None if it is unknown."""
    provenance: Provenance
    """The file's name and hash, its recorder's notes, and the numbers of dropped samples if there are any."""


@dataclass(frozen=True)
class _Layout:
    """Which cells of a line count, and what they mean."""

    delimiter: str
    width: int
    columns: list[int]
    """Indices, the time first."""
    fields: list[str]
    """What messages call them."""
    units: tuple[str, ...]
    """Unit of each power column."""
    first_line: int

    @property
    def is_share(self) -> bool:
        """Whether the power is a share of a rating."""
        return SHARE in self.units

    @property
    def kw(self) -> FloatArray:
        """The kW for 1 in each power column, (n_power,)."""
        return np.array([1.0 if unit == SHARE else KW_PER_UNIT[unit] for unit in self.units])

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
    invalid: str = "error",
) -> CsvSamples:
    """Read times and the sum of the power columns, with 16 bytes of memory for each line and a few MB of text.

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip, one sample on each line. Empty lines are skipped, and so are lines at the
        top that begin with `#`. The JSON object after `# dcgrid trace ` in the first line goes to the provenance.
    time_column : index from 0 or header name; times in s. A name with another unit (`time_ms`, `t [h]`) is refused.
    power_columns : indices or header names, summed; by default every column but the time (one for each GPU).
    unit : of the power columns: "W", "kW", "MW" or "mW"; by default what their names end in, for example `site [kW]`,
        `power (MW)`, `P/kW`, `gpu0_w`. Names without a unit are refused. A file without header is in W by default, as
        the published recordings are. "share" is a share of the rating, for one column (`site_share`).
    header : whether the first line contains names; by default it does if none of its cells is a number.
    delimiter : character between cells.
    max_gap_s, gaps : rule for samples that are more than max_gap_s apart, see `dcgrid_env.traces.text.gaps.GapRule`;
        by default every distance is accepted.
    limit_kw : highest accepted power of one cell, kW; the default is 1 GW.
    invalid : rule for samples whose power is missing, not a number or negative: "error", or "drop" to leave them out,
        which makes a gap.

    Returns
    -------
    CsvSamples

    Raises
    ------
    TraceError
        If the file is empty or unreadable, or a unit is unknown, contradicted or missing. If there is an unknown
        column, a text cell, a missing cell, an invalid sample, power above the limit, or a gap. The message contains
        the file and, if there is one, the line.
    """
    if invalid not in INVALID_RULES:
        raise TraceError(f"invalid = {invalid!r} is unknown; choose one of {', '.join(INVALID_RULES)}")
    rule = GapRule(max_gap_s, gaps)
    limit_kw = require_positive(limit_kw, "limit_kw", "give the highest power of one cell in kW")
    if len(delimiter) != 1:
        raise TraceError(f"delimiter = {delimiter!r} is not one character; give the one between cells")
    with open_text(path) as file:
        require_unit(file.name, None if unit == SHARE else unit)
        parameters, row, first = _first_row(file, delimiter)
        has_header = header if header is not None else not any(_is_number(cell) for cell in row)
        layout = _layout(file, row, has_header, time_column, power_columns, unit, delimiter)
        samples = _Samples(file.name, layout, rule, HIGHEST_SHARE if layout.is_share else limit_kw, invalid == "drop")
        for block in file.blocks() if has_header else chain([first], file.blocks()):
            samples.add(block)
        rated_kw = 1.0 if layout.is_share else parameters.get("rated_kw")
        dropped = {name: count for name, count in samples.dropped.items() if count}
        parameters |= {"dropped": dropped} if dropped else {}
        provenance = Provenance(file.name, parameters=parameters, sha256=file.sha256())
    n = len(samples.time_s)
    if n < 2:
        raise TraceError(f"{file.name}: has {n} samples; give at least 2 (a sample holds until the next)")
    return CsvSamples(np.frombuffer(samples.time_s), np.frombuffer(samples.power_kw), rated_kw, provenance)


def csv_columns(
    path: str | os.PathLike[str], power_columns: Sequence[Column] | None = None, unit: str | None = None
) -> dict[str, str]:
    """Return the columns that `read_csv` would read, with their units; "s" is the unit of the time."""
    with open_text(path) as file:
        _, row, _ = _first_row(file, ",")
        layout = _layout(file, row, not any(map(_is_number, row)), 0, power_columns, unit, ",")
    return dict(zip(layout.fields, ("s", *layout.units), strict=True))


class _Samples:
    """Times and summed power of the blocks so far, and the last row for checks across their borders."""

    def __init__(self, name: str, layout: _Layout, rule: GapRule, limit_kw: float, drops: bool) -> None:
        self.time_s, self.power_kw = array("d"), array("d")
        self.dropped = {"not a number": 0, "negative": 0}
        self._name, self._layout, self._rule, self._limit_kw, self._drops = name, layout, rule, limit_kw, drops
        self._last = np.empty((0, len(layout.columns)))

    def add(self, block: Block) -> None:
        """Check and append the samples of a block."""
        layout = self._layout
        table = _numbers(block, layout)
        if table is None:
            table = _careful_numbers(self._name, block, layout, self._drops)
        rows = np.arange(len(table))
        if self._drops:
            missing = ~np.isfinite(table[:, 1:]).all(axis=1)
            negative = ~missing & (table[:, 1:] < 0).any(axis=1)
            self.dropped["not a number"] += int(missing.sum())
            self.dropped["negative"] += int(negative.sum())
            rows = np.flatnonzero(~missing & ~negative)
            table = table[rows]
        if not len(table):
            return
        n_before = len(self._last)
        table = np.concatenate([self._last, table])

        def where(i: int) -> str:
            return f"{self._name}, line {block.line_of(int(rows[i - n_before]), layout.blank)}"

        check_samples(table[:, 0], table[:, 1:], where, layout.fields[0], layout.fields[1:])
        power_kw = table[:, 1:] * layout.kw
        high = np.argwhere(power_kw > self._limit_kw)
        if high.size:
            i, j = high[0]
            if layout.is_share:
                raise TraceError(
                    f"{where(i)}: {layout.fields[1 + j]} is {table[i, 1 + j]:g}, above {HIGHEST_SHARE:g} of the "
                    "rating; give shares from 0 to 1, not per cent"
                )
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


def _careful_numbers(name: str, block: Block, layout: _Layout, drops: bool) -> FloatArray:
    """The chosen cells, (n, n_chosen), read line by line; TraceError for the first that is not a number.

    If samples are dropped, cells of power without a reading are NaN.
    """
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
                if drops and c != layout.columns[0] and row[c].strip().casefold() in _NO_READING:
                    cells.append(float("nan"))
                    continue
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
    rated_kw = noted.get("rated_kw")
    if rated_kw is not None and (isinstance(rated_kw, bool) or not isinstance(rated_kw, int | float) or rated_kw <= 0):
        raise TraceError(f"{name}, line 1: rated_kw is {rated_kw!r}; give the rating of the site in kW, above 0")
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
        units = [_unit(where, names[c], unit) for c in columns[1:]]
        if None in units:
            column = names[columns[1 + units.index(None)]]
            raise TraceError(
                f"{where}: {column!r} names no unit of power; pass unit= (one of {', '.join(KW_PER_UNIT)}), write it "
                "into the name like 'site [kW]' or 'site_kw', or leave the column out with power_columns="
            )
    if SHARE in units and len(units) > 1:
        raise TraceError(
            f"{name}, line {file.line}: has {len(units)} columns of power, and shares of a rating are not summed; "
            "choose one with power_columns="
        )
    return _Layout(
        delimiter=delimiter,
        width=width,
        columns=columns,
        fields=[f"column {c}" if names is None else f"column {c} ({names[c]!r})" for c in columns],
        units=tuple(u or "W" for u in units),
        first_line=file.line,
    )


def _unit(where: str, header: str, unit: str | None) -> str | None:
    """Return the unit of a column, a share included; None if neither its name nor `unit` contains it."""
    named_share = SHARE in (last_word(header).casefold(), bracketed(header)[0].casefold())
    stated = SHARE if named_share else column_unit(where, header, None if unit == SHARE else unit)
    if SHARE in (stated, unit) and None not in (stated, unit) and stated != unit:
        raise TraceError(f"{where}: {header!r} is in {stated}, but unit = {unit!r} is given; leave unit out")
    return stated or unit


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
