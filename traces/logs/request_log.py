"""Request logs in the formats of the Azure LLM inference traces of 2023 and 2024, BurstGPT and Mooncake."""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dcgrid_env.core.user_files import parse_json
from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.logs.timestamps import TIMESTAMP, nanoseconds
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.serving.requests import Requests
from dcgrid_env.traces.text.table_file import TableFile, open_table
from dcgrid_env.traces.text.text_file import Block, stem

COLUMNS = ("TIMESTAMP", "ContextTokens", "GeneratedTokens")
BURST_COLUMNS = ("Timestamp", "Request tokens", "Response tokens")
"""Columns of BurstGPT that are read; others, such as Model and Log Type, are skipped."""
MOONCAKE_FIELDS = ("timestamp", "input_length", "output_length")
LIMITS = (10_000_000, 100_000)
"""Most context and generated tokens of a request that are believed; models take a million at most."""

_CELLS = (rf"({TIMESTAMP})(?:Z|\+00:00)?", r"(\d{1,9})", r"(\d{1,9})")
_BURST_CELLS = (r"(\d{1,10}(?:\.\d{1,9})?)", r"(\d{1,9})", r"(\d{1,9})")
_TOKENS = tuple(f"give a whole number from 1 to {limit}, or remove the request" for limit in LIMITS)
_REMEDIES = ("write times in UTC like 2023-11-16 18:15:46.6805900", *_TOKENS)
_BURST_REMEDIES = ("write times in s from the beginning, like 12.5", *_TOKENS)
_MOONCAKE_REMEDIES = ("write times in ms from the beginning, like 3000", *_TOKENS)

Where = Callable[[int], str]


class _Form(NamedTuple):
    """A format of logs."""

    names: tuple[str, str, str]
    """Columns or fields of time, context tokens and generated tokens."""
    remedies: tuple[str, ...]
    split: Callable[[str, int, str], tuple[str, str, str]]
    """File, number and text of a line -> the cells of `names`; TraceError if a cell has another form."""
    times: Callable[[list[str], Where], NDArray[np.int64]]
    """Cells of time -> ns on the log's clock."""
    skips_failed: bool
    """Whether a request without generated tokens failed and is skipped."""


def read_request_log(
    path: str | os.PathLike[str], name: str | None = None, part_s: tuple[float, float] | None = None
) -> Requests:
    """Read a log of requests, in the format that its first line shows.

    - Azure 2023 and 2024: the header `TIMESTAMP,ContextTokens,GeneratedTokens`, times in UTC.
    - BurstGPT: a header with `Timestamp`, `Request tokens` and `Response tokens`, times in s.
    - Mooncake: `{"timestamp": 0, "input_length": 6758, "output_length": 500, ...}`, times in ms.

    Times count from the first request. `duration_s` ends at the last one, as a log does not contain the idle time after
    it. A part lasts as long as was asked for if the log continues after it. BurstGPT's requests without response tokens
    failed; they are skipped, and their number is in the provenance. Memory use is 24 bytes for each request, and a few
    MB of text.

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip. Times in UTC may contain `T`, `Z` or `+00:00`, and up to 9 decimals. Token
        counts are whole numbers from 1 to those of LIMITS. Empty lines are skipped, and so are lines at the top that
        begin with `#`.
    name : name of the requests; by default the file's name without suffix.
    part_s : begin and end of the part of the log that is read, s from the first request; by default the whole log.
        Times then count from the begin.

    Raises
    ------
    TraceError
        If the header or a line has another format, a token count is out of range, times are out of order, or there
        are fewer than two times. The message contains the file and, if there is one, the line.

    References
    ----------
    P. Patel et al., "Splitwise", ISCA 2024; J. Stojkovic et al., "DynamoLLM", HPCA 2025; Y. Wang et al., "BurstGPT",
    arXiv 2401.17644; R. Qin et al., "Mooncake", FAST 2025.
    """
    if part_s is not None and not 0.0 <= part_s[0] < part_s[1]:
        raise TraceError(f"part_s = {part_s!r} is not a begin and a later end, from 0 s on")
    begin_s, end_s = part_s or (0.0, np.inf)
    arrival_s, context, generated = array("d"), array("q"), array("q")
    origin_ns = last_ns = None
    failed, goes_on = 0, False
    with open_table(path) as file:
        form, first = _form(file)
        for block in chain(first, file.blocks()):
            lines, times, tokens, without = _read(file.name, form, block)
            failed += without
            if not lines:
                continue
            at_ns = form.times(times, lambda i, lines=lines: f"{file.name}, line {lines[i]}")
            back = np.flatnonzero(np.diff(at_ns, prepend=at_ns[0] if last_ns is None else last_ns) < 0)
            if back.size:
                raise TraceError(
                    f"{file.name}, line {lines[back[0]]}: {times[back[0]]} comes before the time of the request "
                    "above; sort the requests by time"
                )
            origin_ns, last_ns = at_ns[0] if origin_ns is None else origin_ns, at_ns[-1]
            at_s = (at_ns - origin_ns) / 1e9
            inside = slice(*np.searchsorted(at_s, (begin_s, end_s)).tolist())
            arrival_s.frombytes((at_s[inside] - begin_s).tobytes())
            context.extend(tokens[::2][inside])
            generated.extend(tokens[1::2][inside])
            goes_on = bool(at_s[-1] >= end_s)
            if goes_on:
                break
        parameters: dict[str, Any] = {"without_response": failed} if form.skips_failed else {}
        if part_s is not None:
            parameters["part_s"] = [begin_s, end_s]
        provenance = Provenance(file.name, parameters=parameters, sha256=file.sha256())
    duration_s = end_s - begin_s if goes_on else (arrival_s or [0.0])[-1]
    if not arrival_s or duration_s == 0:
        interval = "" if part_s is None else f" from {begin_s:g} to {end_s:g} s"
        raise TraceError(f"{file.name}: has {len(arrival_s)} requests{interval}, none after the first time; give more")
    return Requests(
        np.frombuffer(arrival_s),
        np.frombuffer(context, dtype=np.int64),
        np.frombuffer(generated, dtype=np.int64),
        duration_s,
        name or stem(path),
        provenance,
    )


def is_request_log(first_line: str) -> bool:
    """Return whether the first line of a file is that of a request log."""
    azure = COLUMNS[1].casefold() in first_line.casefold()
    return azure or BURST_COLUMNS[1] in first_line or f'"{MOONCAKE_FIELDS[1]}"' in first_line


def _form(file: TableFile) -> tuple[_Form, list[Block]]:
    """Return the format that the first line shows, and this line if it is a request."""
    header = next((line for line in iter(file.readline, "") if line.strip() and not line.startswith("#")), None)
    if header is None:
        raise TraceError(f"{file.name}: is empty; give a log with the header {','.join(COLUMNS)}")
    if header.lstrip().startswith("{"):
        form = _Form(MOONCAKE_FIELDS, _MOONCAKE_REMEDIES, _mooncake_cells, _milliseconds, False)
        return form, [Block(file.line, header)]
    columns = tuple(cell.strip() for cell in header.split(","))
    if columns == COLUMNS:
        split = _splitter(columns, COLUMNS, _CELLS, _REMEDIES)
        return _Form(COLUMNS, _REMEDIES, split, nanoseconds, False), []
    if set(BURST_COLUMNS) <= set(columns):
        split = _splitter(columns, BURST_COLUMNS, _BURST_CELLS, _BURST_REMEDIES)
        return _Form(BURST_COLUMNS, _BURST_REMEDIES, split, _seconds, True), []
    raise TraceError(
        f"{file.name}, line {file.line}: is {header.strip()[:80]!r} instead of the header {','.join(COLUMNS)}; "
        "give a log of these columns, separated by commas, or one of BurstGPT or Mooncake"
    )


def _read(file: str, form: _Form, block: Block) -> tuple[list[int], list[str], list[int], int]:
    """Line, time and tokens (context and generated by turns) of each request of a block, and the number of failed."""
    lines: list[int] = []
    times: list[str] = []
    tokens: list[int] = []
    failed = 0
    for number, line in block.lines():
        time, *counts = form.split(file, number, line)
        context, generated = map(int, counts)
        if generated == 0 and form.skips_failed:
            failed += 1
            continue
        if not (1 <= context <= LIMITS[0] and 1 <= generated <= LIMITS[1]):
            wrong = 1 if not 1 <= context <= LIMITS[0] else 2
            raise _fault(file, number, form.names[wrong], counts[wrong - 1], form.remedies[wrong])
        lines.append(number)
        times.append(time)
        tokens += (context, generated)
    return lines, times, tokens, failed


def _splitter(
    columns: tuple[str, ...], names: tuple[str, str, str], cells: tuple[str, ...], remedies: tuple[str, ...]
) -> Callable[[str, int, str], tuple[str, str, str]]:
    """Return the function that splits a line of the columns into the cells of `names`, which are in their order."""
    cell_of = dict(zip(names, cells, strict=True))
    pattern = re.compile(",".join(rf"[ \t]*{cell_of[c]}[ \t]*" if c in cell_of else "[^,]*" for c in columns))
    order = [[column for column in columns if column in cell_of].index(name) for name in names]

    def split(file: str, number: int, line: str) -> tuple[str, str, str]:
        match = pattern.fullmatch(line)
        if match is None:
            texts = [cell.strip() for cell in line.split(",")]
            if len(texts) != len(columns):
                raise TraceError(f"{file}, line {number}: has {len(texts)} cells, not {len(columns)}; repair the line")
            by_name = {name: texts[columns.index(name)] for name in names}
            wrong = next(i for i, name in enumerate(names) if not re.fullmatch(cells[i], by_name[name]))
            raise _fault(file, number, names[wrong], by_name[names[wrong]], remedies[wrong])
        groups = match.groups()
        return groups[order[0]], groups[order[1]], groups[order[2]]

    return split


def _mooncake_cells(file: str, number: int, line: str) -> tuple[str, str, str]:
    try:
        request = parse_json(line, file, TraceError, "")
    except ValueError:
        request = None
    if not isinstance(request, dict):
        raise TraceError(
            f"{file}, line {number}: {line.strip()[:40]!r} is not a JSON object; repair or remove the line"
        )
    cells = [str(request.get(field)) for field in MOONCAKE_FIELDS]
    for field, cell, remedy in zip(MOONCAKE_FIELDS, cells, _MOONCAKE_REMEDIES, strict=True):
        if not re.fullmatch(r"\d{1,12}", cell):
            raise _fault(file, number, field, cell, remedy)
    return cells[0], cells[1], cells[2]


def _seconds(cells: list[str], where: Where) -> NDArray[np.int64]:
    return np.rint(np.array(cells, dtype=np.float64) * 1e9).astype(np.int64)


def _milliseconds(cells: list[str], where: Where) -> NDArray[np.int64]:
    return np.array(cells, dtype=np.int64) * 1_000_000


def _fault(file: str, number: int, field: str, cell: str, remedy: str) -> TraceError:
    return TraceError(f"{file}, line {number}: {field} is {cell[:40]!r}; {remedy}")
