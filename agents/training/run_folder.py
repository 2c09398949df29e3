"""Output folder of a training run, with the same files for every algorithm.

config.json        configuration and version of dcgrid
curve.csv          a row for each record: step and measurements; only times and rates differ when a run is repeated
events.out.*       the same data for TensorBoard
checkpoint.pt      tensors and plain numbers, read with ``weights_only=True``, so loading does not run code
policy.*           the best policy on the validation split so far, with its card
"""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, TextIO

import torch
from torch.utils.tensorboard import SummaryWriter

from dcgrid_env import Scenario, scenario_hash
from dcgrid_env.agents.policy.policy import Policy
from dcgrid_env.agents.policy.policy_file import SUFFIX
from dcgrid_env.agents.training.config import FREE, Training, stored_config
from dcgrid_env.core.files import clear_parts, naming, new_folder, require_space, whole, write_text
from dcgrid_env.core.lock import LockedError, locked

CHECKPOINT = "checkpoint.pt"
EVENT_BYTES = 2**16
"""Upper bound on the size of a TensorBoard record."""


def device_of(name: str) -> torch.device:
    """Return the named torch device; raise ValueError if the name is invalid or the device is not available."""
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"device is {name!r}, which cannot be used here ({reason}); give cpu, or cuda:0 ..") from None
    return device


class TrainingError(RuntimeError):
    """Report a run that cannot start or continue; the message names file, field, value and remedy."""


@contextmanager
def open_run(folder: Path, config: Training, resume: bool = False, scenarios: Sequence[Scenario] = ()) -> Iterator[Run]:
    """Open a training run in a folder and lock the folder.

    If the run fails or is interrupted before the first checkpoint or policy, its configuration is deleted.

    Parameters
    ----------
    folder
        Output folder; created if it is missing.
    config
        Configuration of the algorithm, a dataclass.
    resume
        Continue from the checkpoint in the folder. If there is none, ``Run.load`` prints a message and the run starts
        from scratch. A queue can therefore start and restart a training with the same command.
    scenarios
        Scenarios of the run. config.json stores their hashes, and a run cannot be resumed with different scenarios.

    Raises
    ------
    TrainingError
        If another process trains in the folder, if it contains a run and ``resume`` is false, or if it contains a run
        with another configuration.
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
    """Read and write the folder of a training run; use :func:`open_run` to create it."""

    def __init__(self, folder: Path, config: Training, resume: bool, scenarios: Sequence[Scenario]):
        self.folder, self.config, self.scenarios, self.resume = folder, config, tuple(scenarios), resume
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
        """Return the contents of the last checkpoint, or None; remove later rows of the curve."""
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
        """Write a checkpoint atomically; it may contain tensors, numbers, strings, and lists and dicts of these."""
        with whole(self.checkpoint_path) as file:
            try:
                torch.save({**state, "step": self.step, "seconds": self.seconds}, file)
            except RuntimeError as error:  # torch's, in place of that of a full disk
                raise error.__context__ if isinstance(error.__context__, OSError) else error from None

    @property
    def seconds(self) -> float:
        """Computing time of the run, s, including the time before an interruption."""
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

    def keep(self, policy: Policy, validation_j: float) -> None:
        """Save the best policy so far, with its mean J on validation on its card."""
        card = {"algorithm": self.config.algorithm(), "seed": self.config.seed, "training_s": self.seconds}
        policy.save(self.folder / f"policy{SUFFIX}", card | {"validation_J": validation_j})

    def require_finite(self, what: str, tensors: Iterable[torch.Tensor]) -> None:
        """Raise TrainingError, with the step and the last checkpoint, unless all values are finite."""
        if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors):
            raise self.diverged(what)

    def diverged(self, what: str) -> TrainingError:
        """Return the error for values that are not finite."""
        checkpoint = (
            f"the checkpoint in {self.checkpoint_path} is from before"
            if self.checkpoint_path.exists()
            else "no checkpoint yet"
        )
        return TrainingError(
            f"training diverged at step {self.step}: {what} not finite; {checkpoint}; try a lower learning rate"
        )

    def close(self) -> None:
        """Close the TensorBoard file."""
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


def read_curve(folder: Path) -> list[dict[str, float]]:
    """Return the rows of a learning curve; missing measurements are NaN, steps are integers."""
    path = folder / "curve.csv"
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = [{name: float(value or "nan") for name, value in row.items()} for row in csv.DictReader(file)]
    return [row | {"step": int(row["step"])} for row in rows]
