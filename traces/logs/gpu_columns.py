"""Which cells of an `nvidia-smi --query-gpu` log hold the time, the power and the GPU."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

from dcgrid_env.traces.checks import TraceError
from dcgrid_env.traces.logs.timestamps import TIMESTAMP
from dcgrid_env.traces.text.cells import MISSING, is_missing
from dcgrid_env.traces.text.power_unit import KW_PER_UNIT, bracketed, column_unit
from dcgrid_env.traces.text.table_file import TableFile
from dcgrid_env.traces.text.text_file import Block

QUERY = "nvidia-smi --query-gpu=timestamp,index,power.draw --format=csv -lms 100"
# The reading of the instant first: on newer GPUs power.draw is a mean over a second.
POWER_NAMES = ("power.draw.instant", "power.draw", "power.draw.average")
GPU_NAMES = ("uuid", "gpu_uuid", "index", "pci.bus_id", "gpu_bus_id", "serial", "gpu_serial")
SEARCHED_LINES = 1000
"""Lines of a log without header in which a power reading is looked for."""

_NUMBER = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?"
_POWER = rf"(?:(?P<power>{_NUMBER})[ \t]*(?P<unit>[A-Za-z]+)?|{MISSING})"
_TIME_CELL = re.compile(rf"\s*{TIMESTAMP}\s*")
_POWER_CELL = re.compile(rf"\s*{_NUMBER}\s*(?:{'|'.join(KW_PER_UNIT)})\s*")
_PLAIN_CELL = re.compile(rf"\s*{_NUMBER}\s*")
_GPU_CELL = re.compile(r"\s*(?:GPU-[0-9a-f-]+|[0-9A-Fa-f]{4,8}:[0-9A-Fa-f]{2}:[0-9A-Fa-f]{2}\.[0-9])\s*")


@dataclass(frozen=True)
class GpuColumns:
    """The columns of a log."""

    width: int
    time: int
    power: int
    gpu: int | None
    """Index of the cell that identifies a GPU; None if there is none."""
    power_name: str
    unit: str | None
    """Unit of readings without one; None if it is unknown."""
    header: tuple[str, ...] | None
    """Names as written in the log, which repeats them where the logger was restarted."""

    def identifies(self, gpu: str) -> bool:
        """Return whether `gpu`, the cell of a line, names a GPU; consumer cards have `[N/A]` as serial number."""
        return self.gpu is not None and not is_missing(gpu)

    def pattern(self) -> re.Pattern[str]:
        """Return the pattern of a line, with groups time, gpu, power (None if the reading is missing) and unit."""
        cells = ["[^,]*"] * self.width
        cells[self.time] = rf"[ \t]*(?P<time>{TIMESTAMP})[ \t]*"
        cells[self.power] = rf"[ \t]*{_POWER}[ \t]*"
        if self.gpu is not None:
            cells[self.gpu] = r"[ \t]*(?P<gpu>[^,]*?)[ \t]*"
        return re.compile(("(?P<gpu>)" if self.gpu is None else "") + ",".join(cells))


def split(line: str) -> tuple[str, ...]:
    """Split a line into cells without the spaces that follow the commas."""
    return tuple(cell.strip() for cell in line.split(","))


def find_columns(
    file: TableFile, columns: str | Sequence[str] | None, unit: str | None
) -> tuple[GpuColumns, list[Block]]:
    """Columns of a log, from its header, from `columns` or from its cells, and the lines read so far.

    Raises
    ------
    TraceError
        For an empty log, one without time or power, and one whose columns cannot be recognised.
    """
    lines = (line for line in iter(file.readline, "") if line.strip() and not line.startswith("#"))
    line = next(lines, None)
    if line is None:
        raise TraceError(f"{file.name}: is empty; give a log of `{QUERY}`")
    where, first = f"{file.name}, line {file.line}", Block(file.line, line)
    header = split(line)
    if "timestamp" in header:
        if columns is not None:
            raise TraceError(f"{where}: is a header; leave columns out, they are for a log without one")
        return _from_names(where, header, unit, header), []
    if columns is not None:
        names = split(columns) if isinstance(columns, str) else tuple(columns)
        return _from_names(f"{file.name}: columns", names, unit, None), [first]
    return _from_cells(where, file, first, chain([line], lines), unit)


def _from_names(where: str, names: tuple[str, ...], unit: str | None, header: tuple[str, ...] | None) -> GpuColumns:
    bare_names = [re.sub(r"\s*\[[^\]]*\]$", "", name) for name in names]
    power = next((bare_names.index(name) for name in POWER_NAMES if name in bare_names), None)
    if power is None or "timestamp" not in bare_names:
        missing = "timestamp" if "timestamp" not in bare_names else "power.draw"
        raise TraceError(f"{where}: {', '.join(names)} has no {missing}; log with `{QUERY}`")
    return GpuColumns(
        width=len(names),
        time=bare_names.index("timestamp"),
        power=power,
        gpu=next((bare_names.index(name) for name in GPU_NAMES if name in bare_names), None),
        power_name=bare_names[power],
        unit=column_unit(where, names[power], unit) if bracketed(names[power])[1] else unit,
        header=header,
    )


def _from_cells(where: str, file: TableFile, first: Block, lines, unit: str | None) -> tuple[GpuColumns, list[Block]]:
    """Detect the columns of a log without header by the first line with a time and one reading with its unit.

    The cells may omit the unit if `unit` is given and a line contains only the time and a number.
    """
    read: list[Block] = []
    remedy = "pass columns='timestamp,index,power.draw', as they were queried, or log with a header"
    for line in lines:
        read.append(Block(file.line, line) if read else first)
        cells = split(line)
        time = [c for c, cell in enumerate(cells) if _TIME_CELL.fullmatch(cell)]
        if len(time) != 1:
            raise TraceError(f"{where}: is neither a header with timestamp nor a line with one time; {remedy}")
        power = [c for c, cell in enumerate(cells) if _POWER_CELL.fullmatch(cell)]
        if len(power) > 1:
            raise TraceError(f"{where}: {len(power)} cells are power, {', '.join(cells[c] for c in power)}; {remedy}")
        others = [c for c, cell in enumerate(cells) if c not in time and _PLAIN_CELL.fullmatch(cell)]
        if not power and len(cells) == 2 and others:
            power = others
        if power:
            gpu = next((c for c, cell in enumerate(cells) if _GPU_CELL.fullmatch(cell)), None)
            return GpuColumns(len(cells), time[0], power[0], gpu, "power.draw", unit, None), read
        if len(read) == SEARCHED_LINES:
            break
    raise TraceError(
        f"{where}: no cell from here to line {file.line} is power with its unit, such as 70.25 W; {remedy}, and pass "
        "unit= if the numbers have none"
    )
