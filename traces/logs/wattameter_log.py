"""Power logs of WattAMeter, the recorder of the National Laboratory of the Rockies (NLR, formerly NREL)."""

from __future__ import annotations

import os
import re

from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.logs.meters import Meters
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.recording_clock import BEGAN
from dcgrid_env.traces.text.cells import not_a_number, reading
from dcgrid_env.traces.text.dates import seconds
from dcgrid_env.traces.text.power_unit import KW_PER_UNIT
from dcgrid_env.traces.text.text_file import open_text, stem
from dcgrid_env.traces.text.times import clock_text
from dcgrid_env.traces.trace import PowerTrace

HEADER = re.compile(r"#\s*timestamp\s+reading-time\[ns\]\s+(?P<columns>\S.*)")
_COLUMN = re.compile(r"(?P<meter>.+)\[(?P<unit>[^\[\]]+)\]")


def read_wattameter_log(
    path: str | os.PathLike[str],
    *,
    max_gap_s: float | None = None,
    gaps: str = "error",
    limit_kw: float | None = None,
    name: str | None = None,
) -> PowerTrace:
    """Read the sum of all columns of power, for example of the GPUs of a node (`gpu-0[mW]`).

    Columns of other quantities, such as temperatures, are skipped. The domain of the cores of a processor
    (`cpu-0-core[W]`) is part of its package (`cpu-0[W]`) and is skipped too.

    Parameters
    ----------
    path : text file, UTF-8, plain or gzip, with the header `# timestamp reading-time[ns] gpu-0[mW] ...`. The header may
        be repeated. Times are of the form `2025-01-01_00:00:00.123456`, on the recorder's own clock.
    max_gap_s, gaps : rule for readings that are far apart, see `dcgrid_env.traces.logs.meters.Meters`.
    limit_kw : highest accepted reading, kW; 2 kW by default.
    name : name of the trace; by default the file's name without suffix.

    Raises
    ------
    TraceError
        If the header has no column of power, a line cannot be read, times repeat or go back, or there is a gap. The
        message contains the file and the line.

    References
    ----------
    NLR, WattAMeter 0.9.3 (github.com/NatLabRockies/WattAMeter), `Tracker.write_header`.
    """
    with open_text(path) as file:
        power: list[tuple[int, str, float]] = []
        width, meters = 0, None
        for block in file.blocks():
            for number, line in block.lines():
                where = f"{file.name}, line {number}"
                header = HEADER.match(line)
                if header is not None:
                    columns = header["columns"].split()
                    power, width = _power_columns(where, columns), 2 + len(columns)
                    continue
                if line.startswith("#"):
                    continue
                cells = line.split()
                if not power or len(cells) != width:
                    if power and not block.text.endswith("\n") and block.text.endswith(line):
                        continue  # the last line was cut short
                    fault = f"has {len(cells)} cells, not {width}" if power else "comes before the header"
                    raise TraceError(f"{where}: {fault}; repair or remove the line, and keep the header")
                if meters is None:
                    meters = Meters(
                        file.name, "power", "kW", max_gap_s=max_gap_s, gaps=gaps, limit_kw=limit_kw,
                        placed=lambda meter, line: f"{file.name}, line {line}: {meter}",
                    )  # fmt: skip
                time_s = seconds(cells[0], where)
                for column, meter, kw in power:
                    meters.add(meter, time_s, kw * _number(where, meter, cells[column]), number)
        sha256 = file.sha256()
    if meters is None:
        raise TraceError(f"{file.name}: has no reading; give a log of WattAMeter")
    total = meters.total()
    parameters = {BEGAN: clock_text(total.begin_s), "meters": len(meters.meters)} | total.notes
    return total.trace(name or stem(path), Provenance(file.name, None, parameters, sha256))


def _power_columns(where: str, columns: list[str]) -> list[tuple[int, str, float]]:
    """Index in a line, name and kW for 1 of each column of power."""
    power_columns = []
    for index, column in enumerate(columns, 2):
        match = _COLUMN.fullmatch(column)
        if match is not None and match["unit"] in KW_PER_UNIT and not match["meter"].endswith("-core"):
            power_columns.append((index, match["meter"], KW_PER_UNIT[match["unit"]]))
    if not power_columns:
        raise TraceError(f"{where}: no column of {', '.join(columns)} is power in {', '.join(KW_PER_UNIT)}")
    return power_columns


def _number(where: str, meter: str, text: str) -> float:
    try:
        return reading(text)
    except ValueError:
        raise TraceError(f"{where}: {meter} {not_a_number(text)}") from None
