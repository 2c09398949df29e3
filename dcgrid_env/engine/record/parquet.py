"""Trajectories of long episodes as Parquet: a folder of files, written during the run, each a period of all episodes.

Files are written completely or not at all. If a run is killed or the disk is full, the earlier files are a dataset that
any Parquet reader opens. docs/decisions/0012-long-episodes.md explains the choice of Parquet.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env.core.files import clear_parts, whole
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.devices.device import DeviceState
from dcgrid_env.engine.physics.dynamics import device_slices
from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.scenario.costs.load_requests import RequestColumns
from dcgrid_env.scenario.fingerprint import scenario_hash
from dcgrid_env.scenario.scenario import Scenario

FILE_BYTES = 32 * 2**20
"""Size at which a file is written, before compression."""
REMEDY = from_clone("parquet")


class ParquetCourse:
    """Writes the trajectories of a batch to ``folder/part-00000.parquet`` and so on; a context manager.

    Columns are those of ``course_table`` with ``seed`` in front, figures as float32; rows of a file are ordered by
    seed, a row group each. Leaving the block writes the remaining steps, unless by an error.

    Parameters
    ----------
    folder
        The folder to write; it is created if missing. Parts of an earlier run in it are deleted.
    scenario
        What is run.
    seeds
        Those of the environments.

    Raises
    ------
    ValueError
        If pyarrow is not installed, with the remedy, before anything is written.
    """

    def __init__(self, folder: Path, scenario: Scenario, seeds: Sequence[int]):
        require_pyarrow()
        self.folder, self.seeds = folder, tuple(seeds)
        self._about = {
            "dcgrid_scenario": scenario.name, "dcgrid_split": scenario.split, "dcgrid_dt_s": repr(float(scenario.dt_s)),
            "dcgrid_scenario_hash": scenario_hash(scenario), "dcgrid_horizon": str(scenario.horizon),
        }  # fmt: skip
        self._waiting: list[list[dict[str, np.ndarray]]] = [[] for _ in self.seeds]
        self._bytes = 0
        self._files = 0
        self.bytes_written = 0
        """Size of the files so far."""
        if folder.is_dir():
            clear_parts(folder)
            for old in folder.glob("part-*.parquet"):
                old.unlink()

    def __enter__(self) -> ParquetCourse:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self._write()

    def add(self, parts: Sequence[Series | None], first_step: int) -> None:
        """Take the next steps of every environment, see ``streaming_recorder.PartSink``."""
        for waiting, part in zip(self._waiting, parts, strict=True):
            if part is not None:
                waiting.append(course_table(part, first_step))
                self._bytes += sum(column.nbytes for column in waiting[-1].values())
        if self._bytes >= FILE_BYTES:
            self._write()

    def _write(self) -> None:
        if not self._bytes:
            return
        import pyarrow
        from pyarrow import parquet

        path = self.folder / f"part-{self._files:05d}.parquet"
        with whole(path) as file:
            writer: Any = None
            for seed, waiting in zip(self.seeds, self._waiting, strict=True):
                if not waiting:
                    continue
                joined = {name: np.concatenate([table[name] for table in waiting]) for name in waiting[0]}
                columns = {"seed": np.full(len(joined["step"]), seed, np.int64)} | joined
                table = pyarrow.table(columns)
                if writer is None:
                    # Neighbouring values of a float share their leading bytes, which the split puts side by side.
                    floats: Any = [name for name, values in columns.items() if values.dtype.kind == "f"]
                    writer = parquet.ParquetWriter(
                        file, table.schema.with_metadata(self._about), compression="zstd", use_dictionary=False,
                        use_byte_stream_split=floats,
                    )  # fmt: skip
                writer.write_table(table)
                waiting.clear()
            writer.close()
        self.bytes_written += path.stat().st_size
        self._files += 1
        self._bytes = 0


def require_pyarrow() -> None:
    """Raise ValueError, with the remedy, unless pyarrow can be imported."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise ValueError(f"the course of long episodes is written by pyarrow, which is missing; {REMEDY}") from None


def course_table(part: Series, first_step: int) -> dict[str, np.ndarray]:
    """Columns of some steps of an episode, ``(step,)`` each, those before being ``first_step`` many.

    ``step`` (from 1 on) and ``t_s``; ``cost_j``, the step's share of J times T, and its terms ``cost.NAME``;
    ``loss_kw``; ``v_pu.NODE`` of every node; ``p_kw.AGENT``, the draw, and ``q_kvar.AGENT``, the reactive injection;
    ``FIELD.AGENT`` for each field of a device's state that is one number an agent, as ``f_mhz.dc_0``; of a
    three-phase feeder ``tap.REGULATOR`` and ``capacitor_on.BANK``; and with requests of a utility ``request.lower``,
    ``request.upper`` and the other columns of ``load_requests.RequestColumns``.
    """
    s = part.scenario
    step = np.arange(first_step + 1, first_step + 1 + len(part.cost_j), dtype=np.int32)
    columns: dict[str, np.ndarray] = {"step": step, "t_s": step * float(s.dt_s), "cost_j": part.cost_j}
    columns |= {f"cost.{name}": _single(values) for name, values in part.costs.items()}
    columns["loss_kw"] = _single(part.loss_kw)
    columns |= _of_each("v_pu", s.feeder.node_ids, part.v_pu[1:])
    columns |= _of_each("p_kw", s.agents, part.p_kw)
    columns |= _of_each("q_kvar", s.agents, part.q_kvar)
    for cut, state in zip(device_slices(s), part.devices, strict=True):
        by_field: dict[str, np.ndarray] = {}
        _collect(state, len(s.agents[cut]), by_field)
        for field, values in by_field.items():
            columns |= _of_each(field, s.agents[cut], values[1:])
    if part.three_phase is not None:
        regulators, banks = part.three_phase.equipment
        columns |= _of_each("tap", range(regulators.tap.shape[1]), regulators.tap[1:])
        columns |= _of_each("capacitor_on", range(banks.on.shape[1]), banks.on[1:])
    if part.request is not None:
        columns |= _of_each("request", RequestColumns._fields, part.request)
    return columns


def _single(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32)


def _of_each(name: str, each: Any, values: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}.{one}": _single(values[:, i]) for i, one in enumerate(each)}


def _collect(state: DeviceState, count: int, columns: dict[str, np.ndarray]) -> None:
    """Return the fields of a device's state with one number per agent, with features, without the previous step's."""
    for field, values in zip(getattr(state, "_fields", ()), state, strict=False):
        if isinstance(values, tuple):
            for part in (values,) if hasattr(values, "_fields") else values:
                _collect(part, count, columns)
        elif getattr(values, "ndim", 0) == 2 and values.shape[1] == count and not field.endswith("_last_mhz"):
            columns.setdefault(field, values)
