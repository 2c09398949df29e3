"""Reading a power trace from a text file of any size, with errors that name the line and the column."""

import csv
import io
import os
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.user_files import parse_json
from dcgrid_env.traces.checks import FloatArray, TraceError, check_samples, require_positive
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.text.cells import is_missing, is_number, not_a_number
from dcgrid_env.traces.text.dates import FORMS
from dcgrid_env.traces.text.gaps import GapRule
from dcgrid_env.traces.text.power_limits import above_limit, limit_of, outlier, outlier_text
from dcgrid_env.traces.text.power_unit import (
    KW_PER_UNIT,
    bracketed,
    column_unit,
    last_word,
    other_quantity,
    require_power,
    require_summable,
    require_unit,
)
from dcgrid_env.traces.text.table_file import TableFile, open_table
from dcgrid_env.traces.text.text_file import Block
from dcgrid_env.traces.text.times import Clock, clock_of, is_time_name

RECORDED = "# dcgrid trace "
"""Begins the first line of a recorder's file; a JSON object follows."""
SHARE = "share"
"""Unit of power as a share of a rating."""
HIGHEST_SHARE = 2.0
INVALID_RULES = ("error", "drop")
_BLANK = ' \t\n",'
"""Characters of a line without content."""

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

    time_name: str
    """Name of the column of times; "" without a header."""
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


def read_csv(
    path: str | os.PathLike[str],
    time_column: Column | None = None,
    power_columns: Sequence[Column] | None = None,
    unit: str | None = None,
    header: bool | None = None,
    delimiter: str | None = None,
    *,
    max_gap_s: float | None = None,
    gaps: str = "error",
    limit_kw: float | None = None,
    invalid: str = "error",
) -> CsvSamples:
    """Read times and the sum of the power columns, with 16 bytes of memory for each line and a few MB of text.

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip, one sample on each line. Empty lines are skipped, and so are lines at the
        top that begin with `#`. The JSON object after `# dcgrid trace ` in the first line goes to the provenance.
    time_column : index from 0 or header name; by default the first one with a name of times, or else the first. Times
        are in s, or in the unit of the name (`time_ms`, `t [h]`). Times since 1970 may be in s, ms, us or ns, which
        their size shows.
    power_columns : indices or header names, summed; by default every column but the time (one for each GPU).
    unit : of the power columns: "W", "kW", "MW" or "mW"; by default what their names end in, for example `site [kW]`,
        `power (MW)`, `P/kW`, `gpu0_w`. Names without a unit are refused. A file without header is in W by default, as
        the published recordings are. "share" is a share of the rating, for one column (`site_share`).
    header : whether the first line contains names; by default it does if none of its cells is a number.
    delimiter : character between cells; by default the comma, semicolon or tab that the first lines show. With another
        one than the comma, numbers may have decimal commas.
    max_gap_s, gaps : rule for samples that are more than max_gap_s apart, see `dcgrid_env.traces.text.gaps.GapRule`;
        by default every distance is accepted.
    limit_kw : highest accepted power of one cell, kW; by default 2 kW for a column of one GPU or processor
        (`gpu0_w`), and 1 GW for others, whose outliers are refused too.
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
    if limit_kw is not None:
        require_positive(limit_kw, "limit_kw", "give the highest power of one cell in kW")
    if delimiter is not None and len(delimiter) != 1:
        raise TraceError(f"delimiter = {delimiter!r} is not one character; give the one between cells")
    with open_table(path, delimiter) as file:
        require_unit(file.name, None if unit == SHARE else unit)
        parameters, row, first = _first_row(file)
        has_header = header if header is not None else not any(is_number(cell) for cell in row)
        layout = _layout(file, row, has_header, time_column, power_columns, unit)
        samples = _Samples(file.name, layout, rule, limit_kw, invalid == "drop")
        for block in file.blocks() if has_header else chain([first], file.blocks()):
            samples.add(block)
        rated_kw = 1.0 if layout.is_share else parameters.get("rated_kw")
        dropped = {name: count for name, count in samples.dropped.items() if count}
        parameters |= {"dropped": dropped} if dropped else {}
        provenance = Provenance(file.name, parameters=parameters, sha256=file.sha256())
    n = len(samples.time_s)
    if n < 2:
        raise TraceError(f"{file.name}: has {n} samples; give at least 2 (a sample holds until the next)")
    samples.require_no_outlier()
    return CsvSamples(np.frombuffer(samples.time_s), np.frombuffer(samples.power_kw), rated_kw, provenance)


def csv_columns(
    path: str | os.PathLike[str], power_columns: Sequence[Column] | None = None, unit: str | None = None
) -> dict[str, str]:
    """Return the columns that `read_csv` would read, with their units; the first is the time."""
    with open_table(path) as file:
        _, row, first = _first_row(file)
        has_header = not any(map(is_number, row))
        layout = _layout(file, row, has_header, None, power_columns, unit)
        if has_header:
            line = next(line for line in iter(file.readline, "") if line.strip(_BLANK))
            first = Block(file.line, line)
    time = _careful_numbers(file.name, first, layout, True)[0, 0]
    clock = clock_of(float(time), file.name, layout.time_name)
    return dict(zip(layout.fields, (clock.unit, *layout.units), strict=True))


class _Samples:
    """Times and summed power of the blocks so far, and the last row for checks across their borders."""

    def __init__(self, name: str, layout: _Layout, rule: GapRule, limit_kw: float | None, drops: bool) -> None:
        self.time_s, self.power_kw = array("d"), array("d")
        self.dropped = {"not a number": 0, "negative": 0}
        self.clock: Clock | None = None
        """Unit of the times, known from the first sample."""
        self._name, self._layout, self._rule, self._drops = name, layout, rule, drops
        self._finds_outliers = limit_kw is None and not layout.is_share
        self._limit_kw = np.array(
            [HIGHEST_SHARE if layout.is_share else limit_of(field, limit_kw) for field in layout.fields[1:]]
        )
        self._highest = (0.0, "")
        """Highest power of one cell so far, kW, and its place."""
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

        def where(i: int) -> str:
            return f"{self._name}, line {block.line_of(int(rows[i - n_before]), _BLANK)}"

        if self.clock is None:
            self.clock = clock_of(float(table[0, 0]), f"{where(0)}: {layout.fields[0]}", layout.time_name)
        table[:, 0] = self.clock.seconds(table[:, 0], lambda i: f"{where(i + n_before)}: {layout.fields[0]}")
        table = np.concatenate([self._last, table])
        bad = np.argwhere(~np.isfinite(table[:, 1:]))
        if bad.size:
            i, j = bad[0]
            raise TraceError(
                f"{where(i)}: {layout.fields[1 + j]} is {table[i, 1 + j]}; remove or repair the sample, or pass "
                "invalid='drop'"
            )
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
                f"{where(i)}: {layout.fields[1 + j]} is {table[i, 1 + j]:g} {layout.units[j]}, "
                f"{above_limit(float(self._limit_kw[j]))}"
            )
        if power_kw.max() > self._highest[0]:
            i, j = np.unravel_index(int(np.argmax(power_kw)), power_kw.shape)
            if i >= n_before:
                self._highest = float(power_kw[i, j]), f"{where(int(i))}: {layout.fields[1 + int(j)]}"
        time_s, total_kw = self._rule.apply(table[:, 0], power_kw.sum(axis=1), where)
        self.time_s.frombytes(time_s[n_before:].tobytes())
        self.power_kw.frombytes(total_kw[n_before:].tobytes())
        self._last = table[-1:]

    def require_no_outlier(self) -> None:
        """Raise TraceError if the highest power is an outlier."""
        power_kw = np.frombuffer(self.power_kw)
        if self._finds_outliers and outlier(power_kw) is not None:
            highest_kw, place = self._highest
            raise TraceError(f"{place} is {outlier_text(highest_kw, float(np.median(power_kw)))}")


def _numbers(block: Block, layout: _Layout) -> FloatArray | None:
    """The chosen cells, (n, n_chosen); None for a block that needs a closer look, for an error or for odd cells."""
    text, width = block.text, layout.width
    if '"' in text or text.isspace():
        return None
    everything = layout.columns == list(range(width))
    if not everything and any(line.count(",") != width - 1 for _, line in block.lines()):
        return None
    columns = None if everything else layout.columns
    try:
        table = np.loadtxt(io.StringIO(text), delimiter=",", comments=None, usecols=columns, ndmin=2)
    except ValueError:
        return None
    return table if table.shape[1] == len(layout.columns) else None


def _careful_numbers(name: str, block: Block, layout: _Layout, drops: bool) -> FloatArray:
    """The chosen cells, (n, n_chosen), read line by line; TraceError for the first that is not a number.

    If samples are dropped, cells of power without a reading are NaN.
    """
    cells = array("d")
    for number, line in block.lines(_BLANK):
        row = next(csv.reader([line])) if '"' in line else line.split(",")
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
                missing = c != layout.columns[0] and is_missing(row[c])
                if drops and missing:
                    cells.append(float("nan"))
                    continue
                fault = not_a_number(row[c])
                if c == layout.columns[0] and is_time_name(layout.time_name):
                    fault = f"is {row[c].strip()[:40]!r}, not a number; write times in s, or in one column like {FORMS}"
                if number == layout.first_line:
                    fault += "; if the line has the names of the columns, give each one that is not a number"
                elif missing:
                    fault += ", or pass invalid='drop'"
                raise TraceError(f"{name}, line {number}: {field} {fault}") from None
    return np.array(cells, dtype=np.float64).reshape(-1, len(layout.columns))


def _first_row(file: TableFile) -> tuple[dict[str, Any], list[str], Block]:
    """What the recorder noted, and the first line with content as cells and as a block."""
    parameters: dict[str, Any] = {}
    for line in iter(file.readline, ""):
        if file.line == 1 and line.startswith(RECORDED):
            parameters = _noted(file.name, line)
        if not line.startswith("#") and line.strip(_BLANK):
            first = Block(file.line, line)
            # A name in quotes may hold a line end, as spreadsheets write them; the reader then takes further lines.
            row = next(csv.reader(chain([line], iter(file.readline, ""))))
            return parameters, row, first
    raise TraceError(f"{file.name}: is empty; give a file with a time column and at least one power column")


def _noted(name: str, line: str) -> dict[str, Any]:
    """The JSON object of a recorder's first line."""
    where = f"{name}, line 1: what follows {RECORDED!r}"
    noted = parse_json(line.removeprefix(RECORDED), where, TraceError, "repair it")
    if not isinstance(noted, dict):
        raise TraceError(f"{name}, line 1: what follows {RECORDED!r} is {noted!r}; give a JSON object")
    rated_kw = noted.get("rated_kw")
    if rated_kw is not None and (isinstance(rated_kw, bool) or not isinstance(rated_kw, int | float) or rated_kw <= 0):
        raise TraceError(f"{name}, line 1: rated_kw is {rated_kw!r}; give the rating of the site in kW, above 0")
    return noted


def _layout(file: TableFile, row: list[str], has_header: bool, time_column, power_columns, unit: str | None) -> _Layout:
    name, width = file.name, len(row)
    names = [cell.strip() for cell in row] if has_header else None
    columns = _choose(name, width, names, time_column, power_columns)
    units: list[str | None] = [unit] * (len(columns) - 1)
    if names is not None:
        where = f"{name}, line {file.line}"
        for c in columns[1:]:
            remedy = "name the columns of power with power_columns=, or rename it if it is power"
            require_power(where, names[c], remedy)
            other = other_quantity(names[c]) if power_columns is None else None
            if other is not None:
                raise TraceError(f"{where}: {names[c]!r} names {other!r}, which is no power; {remedy}")
            if power_columns is None and not names[c]:
                raise TraceError(f"{where}: column {c} has no name; {remedy}")
        units = [_unit(where, names[c], unit) for c in columns[1:]]
        if None in units:
            column = names[columns[1 + units.index(None)]]
            raise TraceError(
                f"{where}: {column!r} names no unit of power; pass unit= (one of {', '.join(KW_PER_UNIT)}), write it "
                "into the name like 'site [kW]' or 'site_kw', or leave the column out with power_columns="
            )
        if power_columns is None:
            require_summable(where, [names[c] for c in columns[1:]])
    if SHARE in units and len(units) > 1:
        raise TraceError(
            f"{name}, line {file.line}: has {len(units)} columns of power, and shares of a rating are not summed; "
            "choose one with power_columns="
        )
    return _Layout(
        time_name="" if names is None else names[columns[0]],
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


def _choose(name: str, width: int, names: list[str] | None, time_column: Column | None, power_columns) -> list[int]:
    """Indices of the chosen columns, the time first."""
    if width < 2:
        raise TraceError(
            f"{name}: has {width} column; give a time and at least one power column, with commas, semicolons or tabs "
            "between the cells"
        )
    if time_column is None:
        time_column = next((c for c, text in enumerate(names or ()) if is_time_name(text)), 0)
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
