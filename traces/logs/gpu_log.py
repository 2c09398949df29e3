"""Power logs of ``nvidia-smi --query-gpu=timestamp,power.draw[,index,...] --format=csv -l N``."""

import os
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from dcgrid_env.traces.checks import FloatArray, TraceError, require_positive
from dcgrid_env.traces.logs.gpu_columns import QUERY, GpuColumns, find_columns, split
from dcgrid_env.traces.logs.meters import Total, held_total
from dcgrid_env.traces.logs.timestamps import nanoseconds
from dcgrid_env.traces.provenance import Provenance
from dcgrid_env.traces.recording_clock import BEGAN
from dcgrid_env.traces.text.gaps import LEAST_GAP_S, GapRule, meter_rule
from dcgrid_env.traces.text.power_limits import DEVICE_KW, above_limit
from dcgrid_env.traces.text.power_unit import KW_PER_UNIT, require_unit
from dcgrid_env.traces.text.table_file import open_table
from dcgrid_env.traces.text.text_file import Block, stem
from dcgrid_env.traces.trace import PowerTrace

EARLY_READINGS = 1000
"""Readings at the beginning of a log in which rounds of several GPUs are looked for."""

LEAST_DISTANCES = 10
"""Distances between readings that show such rounds."""


def read_gpu_log(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    unit: str | None = None,
    gpus: int | None = None,
    max_gap_s: float | None = None,
    gaps: str = "error",
    limit_kw: float | None = None,
    name: str | None = None,
) -> PowerTrace:
    """Read the power of all GPUs of a log, summed.

    Each GPU's reading applies until its next one. The sum has a sample for each round of readings, or for each reading
    if there are no rounds (`dcgrid_env.traces.logs.meters.held_total`). It begins when every GPU has reported, which
    becomes time 0, and ends at the last reading of any. Missing readings (`[N/A]`, `[Not Supported]`, `ERR!`) are
    skipped, so the gap between the GPU's readings is longer. A column uuid, index, pci.bus_id or serial identifies the
    GPU. Of several power columns power.draw.instant is preferred. The header may be repeated where the logger was
    restarted. An unreadable last line without a line end was cut short and is dropped, and so is one of a GPU that no
    other line names. Memory use is 24 bytes for each reading, and about 100 while they are summed.

    Parameters
    ----------
    path : text file, UTF-8 or UTF-16, plain or gzip; lines at the top that begin with `#` are skipped.
    columns : for a log without header: what was queried, for example "timestamp,index,power.draw". Without it the
        time, the power with its unit and a uuid or bus id are recognised by their cells.
    unit : of readings without one (`nounits`): "W", "kW", "MW" or "mW"; needed if the header does not name it.
    gpus : number of GPUs; needed if no column identifies them. The lines of a round must then be complete and in the
        same order.
    max_gap_s, gaps : rule for readings of a GPU that are more than max_gap_s apart, see `GapRule` of
        `dcgrid_env.traces.text.gaps`. None for `max_gap_s` is five times the median distance of the GPU's readings, at
        least 15 s. The limit also applies before a GPU's first reading and after its last. If gaps are filled, the log
        begins when all have reported, and a last reading applies to the end.
    limit_kw : highest accepted reading, kW; 2 kW by default.
    name : name of the trace; by default the file's name without suffix.

    Raises
    ------
    TraceError
        If the log is empty, a line cannot be read, or a power is negative or above the limit. If a unit is missing or
        contradicts another, or there is a gap. If the times of a GPU repeat or go back, a GPU never reports, or
        several GPUs cannot be distinguished. The message contains the file and the line.
    """
    GapRule(LEAST_GAP_S if max_gap_s is None else max_gap_s, gaps)  # checks both
    if limit_kw is not None:
        require_positive(limit_kw, "limit_kw", "give the highest reading of a GPU in kW")
    if gpus is not None and gpus < 1:
        raise TraceError(f"gpus = {gpus!r} is below 1; give the number of GPUs in the log")
    with open_table(path) as file:
        require_unit(file.name, unit)
        layout, read = find_columns(file, columns, unit)
        log = _Log(file.name, layout, max_gap_s, gaps, DEVICE_KW if limit_kw is None else limit_kw, gpus)
        for block in chain(read, file.blocks()):
            log.add(block)
        sha256 = file.sha256()
    total, began = log.total()
    parameters = {BEGAN: began, "gpus": len(log.series), "column": layout.power_name} | total.notes
    return total.trace(name or stem(path), Provenance(file.name, None, parameters, sha256))


@dataclass
class _Series:
    """Readings of one GPU."""

    gpu: str
    first_line: int
    time_s: array = field(default_factory=lambda: array("d"))
    power_kw: array = field(default_factory=lambda: array("d"))
    line: array = field(default_factory=lambda: array("q"))


class _Log:
    """Readings of the blocks so far."""

    def __init__(
        self, name: str, columns: GpuColumns, max_gap_s: float | None, gaps: str, limit_kw: float, gpus: int | None
    ) -> None:
        self.series: dict[str, _Series] = {}
        self._name, self._columns, self._limit_kw, self._gpus = name, columns, limit_kw, gpus
        self._max_gap_s, self._gaps = max_gap_s, gaps
        self._origin_ns: int | None = None
        self._match = columns.pattern().fullmatch
        self._in_order = gpus if columns.gpu is None else None
        self._line_in_round = 0
        known = {columns.unit: KW_PER_UNIT[columns.unit]} if columns.unit else KW_PER_UNIT
        self._kw: dict[str | None, float] = {**known}
        if columns.unit:
            self._kw[None] = KW_PER_UNIT[columns.unit]

    def add(self, block: Block) -> None:
        """Read, check and append the lines of a block."""
        numbers: list[int] = []
        times: list[str] = []
        power: list[float] = []
        rows: dict[str, list[int]] = {}
        for number, line in block.lines():
            match = self._match(line)
            if match is None:
                if self._is_header(line):
                    self._line_in_round = 0
                elif not self._is_cut(block, line):
                    raise self._unreadable(number, line)
                continue
            time, gpu, value, unit = match.group("time", "gpu", "power", "unit")
            if self._in_order:
                gpu = str(self._line_in_round % self._in_order)
                self._line_in_round += 1
            if gpu not in self.series:
                if self.series and self._is_cut(block, line):
                    continue  # What names the GPU may be what was cut.
                self.series[gpu] = _Series(gpu, number)
            if value is not None:
                rows.setdefault(gpu, []).append(len(times))
                power.append(self._in_kw(number, value, unit))
                numbers.append(number)
                times.append(time)
        if times:
            at_ns = nanoseconds(times, lambda i: f"{self._name}, line {numbers[i]}")
            if self._origin_ns is None:
                self._origin_ns = int(at_ns[0])
            time_s, power_kw = (at_ns - self._origin_ns) / 1e9, np.array(power)
            for gpu, of_gpu in rows.items():
                self._append(self.series[gpu], time_s[of_gpu], power_kw[of_gpu], [numbers[i] for i in of_gpu])

    def total(self) -> tuple[Total, str]:
        """Return the sum of all GPUs, and the log's clock at time 0."""
        series = list(self.series.values())
        self._require_readings(series)
        if self._gpus is None:
            for s in series:
                if not self._columns.identifies(s.gpu):
                    self._require_one_gpu(s)
        ends_s = min(s.time_s[0] for s in series), max(s.time_s[-1] for s in series)
        summed = held_total({f"GPU {s.gpu}".strip(): self._filled(s, *ends_s) for s in series})
        if len(summed.time_s) < 2:
            raise TraceError(
                f"{self._name}: {len(summed.time_s)} readings from when all {len(series)} GPUs have reported; give at "
                "least 2"
            )
        began = np.datetime64((self._origin_ns or 0) + round(summed.begin_s * 1e9), "ns").astype("datetime64[ms]")
        return summed, str(began)

    def _append(self, series: _Series, time_s: FloatArray, power_kw: FloatArray, lines: list[int]) -> None:
        known = 1 if series.time_s else 0
        joined_s = np.append(series.time_s[-1], time_s) if known else time_s
        back = np.flatnonzero(np.diff(joined_s) <= 0)
        if back.size:
            raise self._order_error(lines[int(back[0]) + 1 - known], series.gpu, joined_s[back[0] : back[0] + 2])
        series.line.extend(lines)
        series.time_s.frombytes(time_s.tobytes())
        series.power_kw.frombytes(power_kw.tobytes())

    def _filled(self, s: _Series, begin_s: float, end_s: float) -> tuple[FloatArray, FloatArray]:
        """Readings of a GPU with its gaps treated; the log lasts from `begin_s` to `end_s`."""
        time_s = np.frombuffer(s.time_s)
        rule = meter_rule(self._max_gap_s, self._gaps, np.diff(time_s))
        for edge, distance_s, text in (
            (0, time_s[0] - begin_s, "first reading comes {:g} s after the first GPU"),
            (-1, end_s - time_s[-1], "last reading comes {:g} s before the end"),
        ):
            if rule.refuses(distance_s):
                raise TraceError(
                    f"{self._name}, line {s.line[edge]}{self._label(s.gpu)}: its {text.format(distance_s)}, more than "
                    f"max_gap_s = {rule.max_gap_s:g}; raise max_gap_s, cut the file there, or pass gaps='hold'"
                )
        return rule.apply(
            time_s, np.frombuffer(s.power_kw), lambda i: f"{self._name}, line {s.line[i]}{self._label(s.gpu)}"
        )

    def _in_kw(self, number: int, value: str, unit: str | None) -> float:
        if unit not in self._kw:
            fault = f"its unit {unit!r} is unknown"
            if unit is None:
                fault = "has no unit, and no header names one"
            elif unit in KW_PER_UNIT:
                fault = f"the header or unit= says {self._columns.unit}"
            raise TraceError(
                f"{self._name}, line {number}: {self._columns.power_name} is {' '.join(filter(None, (value, unit)))}: "
                f"{fault}; pass unit= for readings without one (one of {', '.join(KW_PER_UNIT)}), or repair the line"
            )
        power_kw = float(value) * self._kw[unit]
        if not 0 <= power_kw <= self._limit_kw:
            remedy = "power is consumption and not negative: repair the line"
            if power_kw > 0:
                remedy = above_limit(self._limit_kw)
            raise TraceError(
                f"{self._name}, line {number}: {self._columns.power_name} is {power_kw * 1e3:g} W, {remedy}"
            )
        return power_kw

    def _is_header(self, line: str) -> bool:
        return self._columns.header is not None and split(line) == self._columns.header

    def _is_cut(self, block: Block, line: str) -> bool:
        return not block.text.endswith("\n") and block.text.endswith(line)

    def _unreadable(self, number: int, line: str) -> TraceError:
        cells, columns = split(line), self._columns
        fault = f"has {len(cells)} cells, not {columns.width}"
        if len(cells) == columns.width:
            fault = f"has the time {cells[columns.time][:40]!r} and the power {cells[columns.power][:40]!r}"
            if "timestamp" in cells:
                fault = f"is another header than {', '.join(columns.header or ('none',))}"
        return TraceError(f"{self._name}, line {number}: {fault}; repair or remove the line, or cut the file there")

    def _label(self, gpu: str) -> str:
        return f": GPU {gpu}" if self._columns.gpu is not None or self._in_order else ""

    def _order_error(self, number: int, gpu: str, pair_s: FloatArray) -> TraceError:
        where = f"{self._name}, line {number}{self._label(gpu)}"
        if pair_s[0] == pair_s[1]:
            return TraceError(
                f"{where}: the time repeats the one before; log with `{QUERY}` so that a column tells GPUs apart, "
                "or pass gpus= if the lines of each round are complete and in order"
            )
        several = "" if self._label(gpu) else f" (if several GPUs report by turns, log with `{QUERY}`)"
        return TraceError(
            f"{where}: the time steps back by {pair_s[0] - pair_s[1]:g} s; the clock was set or went off summer time: "
            f"cut the file there, or log with TZ=UTC{several}"
        )

    def _require_readings(self, series: list[_Series]) -> None:
        if not series:
            raise TraceError(f"{self._name}: holds no reading; give a log of `{QUERY}`")
        for s in series:
            if not s.time_s:
                raise TraceError(
                    f"{self._name}, line {s.first_line}{self._label(s.gpu)}: has no reading in the whole log; leave "
                    "the GPU out of the log (nvidia-smi -i) or remove its lines"
                )
        if self._gpus not in (None, len(series)):
            raise TraceError(f"{self._name}: holds {len(series)} GPUs, but gpus = {self._gpus}; correct gpus")

    def _require_one_gpu(self, s: _Series) -> None:
        """Refuse rounds of several GPUs: many readings follow the one before at once, and then comes a pause."""
        distance_s = np.diff(s.time_s[:EARLY_READINGS])
        if len(distance_s) < LEAST_DISTANCES:
            return
        at_once = distance_s < 0.1 * np.quantile(distance_s, 0.95)
        if np.mean(at_once) > 0.3:
            i = int(np.argmax(at_once))
            raise TraceError(
                f"{self._name}, line {s.line[i + 1]}{self._label(s.gpu)}: comes {distance_s[i]:g} s after the reading "
                f"before, as if several GPUs reported together; log with `{QUERY}` so that a column tells them apart, "
                "or pass gpus= (1 if it is one GPU)"
            )
