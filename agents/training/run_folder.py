"""A training run's folder: its configuration, curve, TensorBoard events and checkpoint, for every algorithm alike.

config.json        the configuration and the version that it was run with
curve.csv          a row for each record: step, then figures; a repetition changes times and rates alone
events.out.*       the same for TensorBoard
checkpoint.pt      tensors and plain figures, read with ``weights_only=True``, so that loading never runs code
policy.*           the best policy on the validation split so far, written by the algorithm
"""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, TextIO

import torch
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from torch.utils.tensorboard import SummaryWriter

from dcgrid_env import Scenario, scenario_hash
from dcgrid_env.agents.policy.card import Card
from dcgrid_env.agents.policy.input_range import recorded
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.policy_file import SUFFIX
from dcgrid_env.agents.training.config import stored_config
from dcgrid_env.core.files import clear_parts, naming, new_folder, require_space, whole, write_text
from dcgrid_env.core.lock import LockedError, locked

CHECKPOINT = "checkpoint.pt"
EVENT_BYTES = 2**16
"""More than TensorBoard writes of a record."""
FREE = ("out", "resume")
"""Fields of a configuration that a resumed run may have otherwise."""


def device_of(name: str) -> torch.device:
    """The device of that name; ValueError unless torch knows it and this machine has it."""
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"device is {name!r}, which cannot be used here ({reason}); give cpu, or cuda:0 ..") from None
    return device


class TrainingError(RuntimeError):
    """A run that cannot begin or go on; the message names file, field, value and remedy."""


class Diverged(TrainingError):
    """A training whose figures are no longer finite."""


_watchers: list[Callable[[Mapping[str, float]], None]] = []
"""What is told of each validation of the trainings in this process."""


@contextmanager
def watched(watcher: Callable[[Mapping[str, float]], None]) -> Iterator[None]:
    """Tell ``watcher`` the figures of each validation within the block; what it raises ends the training."""
    _watchers.append(watcher)
    try:
        yield
    finally:
        _watchers.remove(watcher)


@contextmanager
def open_run(folder: Path, config: Any, resume: bool = False, scenarios: Sequence[Scenario] = ()) -> Iterator[Run]:
    """A training run in a folder that nobody else trains in meanwhile.

    A run that ends by an error or an interruption before it has anything to go on from leaves nothing behind.

    Parameters
    ----------
    folder
        Where it stands; made if need be.
    config
        The algorithm's configuration, a dataclass.
    resume
        Go on from the folder's checkpoint. Where there is none yet ``Run.load`` says so on a line, and the run begins
        anew, so that a queue may start and restart a training by the same command.
    scenarios
        What is trained on; their hashes stand in config.json, so that no run goes on with others of the same names.

    Raises
    ------
    TrainingError
        Where another process trains in the folder, or it holds a run and ``resume`` is not asked for, or a run with
        another configuration.
    """
    try:
        with new_folder(folder), locked(folder, "training"):
            clear_parts(folder)  # of a training that was killed
            run = Run(folder, config, resume, scenarios)
            try:
                yield run
            except BaseException:
                run.forget_if_empty()
                raise
            finally:
                run.close()
    except LockedError as error:
        raise TrainingError(str(error)) from None


class Run:
    """A training run's folder; made by :func:`open_run`."""

    def __init__(self, folder: Path, config: Any, resume: bool, scenarios: Sequence[Scenario]):
        self.folder, self.scenarios, self.resume = folder, tuple(scenarios), resume
        self.checkpoint_path = folder / CHECKPOINT
        self.step = 0
        self._before_s = 0.0
        self._began_s = time.perf_counter()
        self._writer: SummaryWriter | None = None
        about = json.loads(json.dumps(dataclasses.asdict(config), default=str))
        about["scenario_hashes"] = [scenario_hash(scenario) for scenario in scenarios]
        if (folder / "config.json").exists():
            self._check(about, resume)
        write_text(folder / "config.json", json.dumps(about | {"version": version("dcgrid-env")}, indent=2) + "\n")

    def _check(self, about: Mapping[str, Any], resume: bool) -> None:
        if not resume:
            raise TrainingError(f"{self.folder}: holds a run already; resume it (--resume), or give another --out")
        path = self.folder / "config.json"
        try:
            before = stored_config(self.folder) or {}
        except ValueError as error:
            raise TrainingError(f"{error}; delete the folder and begin anew") from None
        for field, value in {**about, "version": version("dcgrid-env")}.items():
            if field not in FREE and before.get(field) != value:
                raise TrainingError(
                    f"{path}: {field} was {before.get(field)!r} and is {value!r} now; resume with the same, or give "
                    "another --out"
                )

    def load(self) -> dict[str, Any] | None:
        """What the last checkpoint holds, or None without one; later rows of the curve are dropped."""
        path = self.checkpoint_path
        if not path.exists():
            if self.resume:
                print(f"{self.folder}: no checkpoint to resume from, training begins anew")
            (self.folder / "curve.csv").unlink(missing_ok=True)
            return None
        try:
            state = torch.load(path, weights_only=True)
            self.step, self._before_s = state["step"], state["seconds"]
        except Exception as error:  # zip, pickle and key errors, each of its own kind
            raise TrainingError(
                f"{path}: cut short or not a checkpoint ({type(error).__name__}); delete it, and --resume begins anew"
            ) from None
        earlier = [row for row in read_curve(self.folder) if row["step"] <= self.step]
        rows = io.StringIO(newline="")
        for i, row in enumerate(earlier):
            _write_row(rows, row, with_header=i == 0)
        if rows.getvalue():
            write_text(self.folder / "curve.csv", rows.getvalue())
        else:
            (self.folder / "curve.csv").unlink(missing_ok=True)
        return state

    def save(self, state: Mapping[str, Any]) -> None:
        """Write a checkpoint, whole or not at all; tensors, numbers, strings, and lists and dicts of those."""
        with whole(self.checkpoint_path) as file:
            try:
                torch.save({**state, "step": self.step, "seconds": self.seconds}, file)
            except RuntimeError as error:  # torch's, in place of that of a full disk
                raise error.__context__ if isinstance(error.__context__, OSError) else error from None

    @property
    def seconds(self) -> float:
        """Time spent on this run, before and after an interruption."""
        return self._before_s + time.perf_counter() - self._began_s

    def record(self, figures: Mapping[str, float]) -> None:
        """Add a row to the curve and to TensorBoard, at the current step."""
        row = {"step": self.step, **{name: float(value) for name, value in figures.items()}, "seconds": self.seconds}
        path = self.folder / "curve.csv"
        with naming(path), path.open("a", newline="") as file:
            _write_row(file, row, with_header=file.tell() == 0)
        with naming(self.folder):
            require_space(self.folder, EVENT_BYTES)  # TensorBoard writes in a thread, whose error none can catch
        if self._writer is None:
            self._writer = SummaryWriter(self.folder, purge_step=self.step)
        for name, value in row.items():
            self._writer.add_scalar(name, value, self.step)
        self._writer.flush()
        for watcher in tuple(_watchers):
            watcher(row)

    def require_finite(self, what: str, tensors: Iterable[torch.Tensor]) -> None:
        """TrainingError, with the step and the checkpoint that is kept, unless all is finite."""
        if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors):
            raise self.diverged(what)

    def diverged(self, what: str) -> Diverged:
        """The error for figures that are not finite."""
        checkpoint = (
            f"the checkpoint in {self.checkpoint_path} is from before"
            if self.checkpoint_path.exists()
            else "no checkpoint yet"
        )
        return Diverged(
            f"training diverged at step {self.step}: {what} not finite; {checkpoint}; try a lower learning rate"
        )

    def close(self) -> None:
        """Close TensorBoard's file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def forget_if_empty(self) -> None:
        """Delete the configuration of a run that has neither a checkpoint nor a policy yet."""
        if not self.checkpoint_path.exists() and not list(self.folder.glob("policy.*")):
            (self.folder / "config.json").unlink(missing_ok=True)


def _write_row(file: TextIO, row: Mapping[str, float], with_header: bool) -> None:
    writer = csv.writer(file)
    if with_header:
        writer.writerow(row)
    writer.writerow(["" if math.isnan(value) else repr(value) for value in row.values()])


def finish(run: Run, scenarios: Sequence[Scenario] = ()) -> None:
    """Write into the best policy's card how long the whole run took, and the range of its inputs.

    ``scenarios`` are what it was trained on where that is more than what it was judged on, as variants of it.
    """
    path = run.folder / "policy.json"
    inputs = recorded(Policy.load(path.with_suffix(SUFFIX)), scenarios or run.scenarios)
    dataclasses.replace(Card.load(path), training_s=run.seconds, inputs=inputs).save(path)


def read_curve(folder: Path) -> list[dict[str, float]]:
    """Rows of a run's curve; a figure that was not measured is NaN, steps are whole."""
    path = folder / "curve.csv"
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = [{name: float(value or "nan") for name, value in row.items()} for row in csv.DictReader(file)]
    return [row | {"step": int(row["step"])} for row in rows]


@contextmanager
def progress(description: str, total: int, done: int) -> Iterator[Any]:
    """A progress bar; yields ``advance(completed, text)``."""
    label, status = (TextColumn(form, markup=False) for form in ("{task.description}", "{task.fields[text]}"))
    columns = (label, BarColumn(), TimeRemainingColumn(), status)
    with Progress(*columns) as bar:
        task = bar.add_task(description, total=total, completed=done, text="")
        yield lambda completed, text="": bar.update(task, completed=completed, text=text)
