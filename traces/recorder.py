"""Recording the power of a machine's GPUs to a trace file.

The file begins with one line `# dcgrid trace {json}` that describes the recording. The names of the columns follow,
and a row for each sample: the time in s and the power of each GPU in W. `PowerTrace.from_csv` reads the file.
"""

from __future__ import annotations

import contextlib
import gzip
import json
import math
import shutil
import time
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from dcgrid_env.core.files import whole
from dcgrid_env.traces.checks import TraceError, require_positive, steps_in
from dcgrid_env.traces.nvml import GpuReader, open_gpus, started
from dcgrid_env.traces.text.csv_file import RECORDED

MAX_HZ = 20.0


def record(
    path: str | Path,
    hz: float = 10.0,
    duration_s: float | None = None,
    gpus: Sequence[int] | None = None,
    stop: Callable[[], bool] | None = None,
    progress: Callable[[float, float], None] | None = None,
    overwrite: bool = False,
    clock: Callable[[], float] = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
) -> dict[str, Any]:
    """Sample the power of GPUs at a fixed rate; no setting of a GPU is changed.

    Sample k is due k / hz after the beginning, independent of earlier ones. A late sample is taken once, and those
    whose time has passed are missed. The time of a sample is the middle of reading all GPUs. Ctrl-C ends the recording
    and keeps it.

    Parameters
    ----------
    path : the trace file; compressed if its name ends in .gz. Rows are collected in the same folder in a file that ends
        in .part. A crash leaves it behind, and `PowerTrace.from_csv` reads it.
    hz : samples a second, above 0 to 20.
    duration_s : time from the first sample to the last, s; by default until `stop` or Ctrl-C.
    gpus : indices as nvidia-smi shows them (not those of CUDA_VISIBLE_DEVICES); by default all.
    stop : called after each sample; True ends the recording.
    progress : called after each sample with its time, s, and the power of all GPUs, W.
    overwrite : replace an existing file.
    clock, sleep : functions in s; replaced in tests.

    Returns
    -------
    Content of the first line of the file: driver, rate, samples, missed samples, jitter in s, and how the recording
    ended. For each GPU it contains name, limits, clocks and kind of power reading. Jitter is the distance of the times
    from when they were due.

    Raises
    ------
    TraceError
        If a number is out of range, the file exists or cannot be written, or the machine lacks pynvml, NVML or a GPU.
        If a GPU cannot be read (samples before a failure are kept), or there are fewer than 2 samples.
    """
    path = Path(path)
    hz, last = _rate(hz, duration_s)
    part = _part_of(path, overwrite)
    failure = None
    with started() as nvml:
        chosen = open_gpus(nvml, gpus)
        about = {"started": datetime.now(UTC).isoformat(timespec="milliseconds")}
        about |= {"driver": nvml.nvmlSystemGetDriverVersion(), "hz": hz}
        facts = [gpu.facts() for gpu in chosen]
        log = _Log(len(chosen))
        try:
            with part.open("x", buffering=1, encoding="utf-8", newline="\n") as rows:
                rows.write(",".join(["time_s", *(f"gpu{gpu.index}_w" for gpu in chosen)]) + "\n")
                try:
                    ended = _sample(chosen, rows, log, _slots(1 / hz, last, clock, sleep), clock, stop, progress)
                except TraceError as error:
                    failure, ended = error, str(error)
        finally:
            if len(log.late_s) < 2:
                part.unlink(missing_ok=True)
    if len(log.late_s) < 2:
        raise TraceError(
            f"{path}: the recording ended after {len(log.late_s)} samples and a trace needs 2; nothing is kept"
        ) from failure
    metadata = about | {"ended": ended} | log.summary()
    metadata["gpus"] = [fact | {"sm_clock_mhz": clocks} for fact, clocks in zip(facts, log.clocks(), strict=True)]
    _assemble(part, path, metadata)
    if failure is not None:
        raise TraceError(f"{failure}; the {len(log.late_s)} samples before are kept in {path}") from failure
    return metadata


class _Log:
    """Notes on the recording so far; a clock takes few values, so they are counted."""

    def __init__(self, n_gpu: int) -> None:
        self.late_s = array("d")
        """Time of each sample less the time when it was due, s."""
        self.slot = -1
        """Of the last sample."""
        self._clocks: list[Counter[int]] = [Counter() for _ in range(n_gpu)]
        self._start: list[int | None] = []
        self._end: list[int | None] = []

    def add(self, slot: int, late_s: float, clock_mhz: list[int | None]) -> None:
        self.slot = slot
        self.late_s.append(late_s)
        self._start = self._start or clock_mhz
        self._end = clock_mhz
        for counts, now in zip(self._clocks, clock_mhz, strict=True):
            if now is not None:
                counts[now] += 1

    def summary(self) -> dict[str, Any]:
        jitter_s = np.abs(np.asarray(self.late_s))
        return {
            "samples": len(jitter_s),
            "missed": self.slot + 1 - len(jitter_s),
            "jitter_s": {
                "mean": round(float(jitter_s.mean()), 6),
                "p99": round(float(np.quantile(jitter_s, 0.99)), 6),
                "max": round(float(jitter_s.max()), 6),
            },
        }

    def clocks(self) -> list[dict[str, float | None] | None]:
        """Return the clocks, MHz, of each GPU; None if its clock could not be read."""
        return [
            {
                "start": start,
                "end": end,
                "min": min(counts),
                "mean": round(sum(mhz * n for mhz, n in counts.items()) / counts.total(), 1),
                "max": max(counts),
            }
            if counts
            else None
            for counts, start, end in zip(self._clocks, self._start, self._end, strict=True)
        ]


def _slots(
    period_s: float, last: int | None, clock: Callable[[], float], sleep: Callable[[float], None]
) -> Iterator[tuple[int, float]]:
    """Yield each slot and when it is due, on `clock`, at that time; if late, the latest slot whose time has passed."""
    start_s, slot = clock(), 0
    while last is None or slot <= last:
        wait_s = start_s + slot * period_s - clock()
        if wait_s > 0:
            sleep(wait_s)
        slot = max(slot, math.floor((clock() - start_s) / period_s))
        if last is not None:
            slot = min(slot, last)
        yield slot, start_s + slot * period_s
        slot += 1


def _sample(
    gpus: Sequence[GpuReader],
    rows: TextIO,
    log: _Log,
    slots: Iterator[tuple[int, float]],
    clock: Callable[[], float],
    stop: Callable[[], bool] | None,
    progress: Callable[[float, float], None] | None,
) -> str:
    """Write a row for each slot; return how the recording ended."""
    start_s = None
    try:
        for slot, due_s in slots:
            begin_s = clock()
            power_w = [gpu.power_w() for gpu in gpus]
            middle_s = (begin_s + clock()) / 2
            clock_mhz = [gpu.sm_clock_mhz() for gpu in gpus]
            start_s = due_s if start_s is None else start_s
            rows.write(",".join([f"{middle_s - start_s:.6f}", *(f"{p:.3f}" for p in power_w)]) + "\n")
            log.add(slot, middle_s - due_s, clock_mhz)
            if progress is not None:
                progress(middle_s - start_s, sum(power_w))
            if stop is not None and stop():
                return "stopped"
    except KeyboardInterrupt:
        return "interrupted"
    return "complete"


def _rate(hz: float, duration_s: float | None) -> tuple[float, int | None]:
    """Return the rate and the number of the last sample, None without an end."""
    if not 0 < hz <= MAX_HZ:
        raise TraceError(f"hz = {hz!r} is not above 0 and at most {MAX_HZ:g}; GPUs renew their reading little faster")
    if duration_s is None:
        return float(hz), None
    last = steps_in(require_positive(duration_s, "duration_s", "give a time in seconds"), 1 / hz)
    if last < 1:
        raise TraceError(f"duration_s = {duration_s:g} is shorter than one period of {1 / hz:g} s; record for longer")
    return float(hz), last


def _part_of(path: Path, overwrite: bool) -> Path:
    """Return the file for the rows after checking that the trace file can be written."""
    if not path.parent.is_dir():
        raise TraceError(f"{path}: there is no folder {path.parent}; make it first")
    if path.is_dir() or (path.exists() and not overwrite):
        raise TraceError(f"{path} is there already; choose another name" + ("" if overwrite else " or pass overwrite"))
    part = path.with_name(path.name.removesuffix(".gz") + ".part")
    if part.exists():
        raise TraceError(
            f"{part} is there: another recording is running, or one was cut off; "
            "give what it holds another name, or remove it"
        )
    return part


def _assemble(part: Path, path: Path, metadata: dict[str, Any]) -> None:
    """Write the first line and the rows, and move the complete file into place."""
    with whole(path) as file, part.open("rb") as rows, contextlib.ExitStack() as stack:
        packed = stack.enter_context(gzip.GzipFile(path.name, "wb", fileobj=file)) if path.suffix == ".gz" else file
        packed.write(f"{RECORDED}{json.dumps(metadata, allow_nan=False)}\n".encode())
        shutil.copyfileobj(rows, packed)
    part.unlink()
