"""Run a group of trainings, each in a separate folder, and resume or skip those that exist.

A run is a training configuration with its folder, ``out``. ``finished.json`` stores the settings of a completed run and
``training.log`` its output. Runs are units of work. They use their folders directly if the worker can access them, and
otherwise a folder that is transferred with the work.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import json
import shlex
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from dcgrid_env.agents.training.config import FREE
from dcgrid_env.baselines.carried import carried
from dcgrid_env.core.files import new_folder, write_bytes, write_json
from dcgrid_env.core.lock import LockedError, locked
from dcgrid_env.core.user_files import read_json
from dcgrid_env.core.versions import command_of, command_words
from dcgrid_env.core.work.unit import Lost, Place, Unit

FINISHED, LOG = "finished.json", "training.log"


def command(config: Any) -> str:
    """The command that does a run by itself: what differs from what it does on that scenario anyway, and the folder."""
    words, plain = ["dcgrid", "train", config.algorithm()], type(config).for_scenario(config.scenario, config.view)
    always = {"scenario"} | ({"view"} if config.view != type(config).view else set())
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.name == "resume" or (value == getattr(plain, field.name) and field.name not in always):
            continue
        flag = field.name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{flag}" if value else f"--no-{flag}")
        else:
            values = value if isinstance(value, tuple) else (value,)
            shown = (repr(float(one)).removesuffix(".0") if isinstance(one, float) else str(one) for one in values)
            words += [f"--{flag}", *map(shlex.quote, shown)]
    return " ".join(words)


def words_of(config: Any) -> list[str]:
    """Words of that command, as a policy's card is to name it."""
    return shlex.split(command(config))


def finished(config: Any) -> bool:
    """Return whether the run is complete, with exactly these settings."""
    try:
        return read_json(config.folder / FINISHED, ValueError, "train again") == _settings(config)
    except (OSError, ValueError):
        return False


def train(config: Any) -> str | None:
    """Do a run, or what is left of it; why it failed, if it did.

    Only what the run itself reports as a failure (it diverged, its folder holds another run) is returned; all else is
    raised.
    """
    from dcgrid_env.agents.training.run_folder import TrainingError

    folder = config.folder
    try:
        with new_folder(folder), _log(folder / LOG) as log, contextlib.redirect_stdout(log):
            begun = (folder / "config.json").exists()
            importlib.import_module(type(config).__module__).main(dataclasses.replace(config, resume=begun))
    except TrainingError as error:
        return str(error)
    write_json(folder / FINISHED, _settings(config))
    return None


@contextlib.contextmanager
def _log(path: Path) -> Iterator[TextIO]:
    """A log to add to; gone again where nothing was said in it."""
    try:
        with path.open("a", encoding="utf-8") as log:
            yield log
    finally:
        if path.stat().st_size == 0:
            path.unlink()


def _settings(config: Any) -> dict[str, Any]:
    about = {name: value for name, value in dataclasses.asdict(config).items() if name not in FREE}
    return json.loads(json.dumps(about, default=str))


Files = dict[str, bytes]
"""Contents of a run's folder by file name."""


class _Sent(NamedTuple):
    """Data that a worker needs for a run."""

    config: Any
    words: Sequence[str]
    """Command for the policy's card."""
    files: Files | None
    """What the run's folder holds, for a worker that does not see it."""


def train_all(
    configs: Sequence[Any],
    place: Place,
    words: Callable[[Any], Sequence[str]] = lambda _: command_words(),
) -> Iterator[tuple[Any, str | None]]:
    """Do runs as units of a place; each with why it failed, if it did, as they are done.

    Leaving the iterator ends them; a later call continues from their checkpoints.

    Parameters
    ----------
    configs
        Training configurations.
    place
        Where they run. Workers that do not see the runs' folders are sent what these hold and send back what they then
        hold, which is written here, ``finished.json`` last: where such a worker dies, its run begins from what the
        folder held when the command began.
    words
        The command that a run's card is to name.
    """
    units = [
        Unit(
            str(config.folder),
            _train,
            _Sent(config, words(config), _held(config.folder) if place.is_remote else None),
            config.threads,
            int(config.device.startswith("cuda")),
        )
        for config in configs
    ]
    for unit, result in place.run(units, carried(place, [config.scenario for config in configs])):
        config = unit.item.config
        if isinstance(result, Lost):
            yield config, result.reason
            continue
        failure, files = result
        try:
            _write(config.folder, files or {})
        except LockedError as error:
            failure = str(error)
        yield config, failure


def _train(sent: _Sent) -> tuple[str | None, Files | None]:
    """Do a run: why it failed, if it did, and what its folder holds where that is not seen by who asked for it."""
    with command_of(sent.words):
        if sent.files is None:
            return train(sent.config), None
        with tempfile.TemporaryDirectory(prefix="dcgrid-") as place:
            folder = Path(place) / "run"
            for name, content in sent.files.items():
                write_bytes(folder / name, content)
            failure = train(dataclasses.replace(sent.config, out=folder))
            run_folder = str(sent.config.folder)
            return failure and failure.replace(str(folder), run_folder), _renamed(
                _held(folder), str(folder), sent.config
            )


def _held(folder: Path) -> Files:
    """Return the contents of a run's folder, without locks and incomplete files."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.name.startswith(".")]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _renamed(files: Files, folder: str, config: Any) -> Files:
    """The files with the run's own folder in the place of the one where it was done."""
    if LOG in files:
        files[LOG] = files[LOG].replace(folder.encode(), str(config.folder).encode())
    if "config.json" in files:
        about = json.loads(files["config.json"]) | {"out": config.out and str(config.out)}
        files["config.json"] = (json.dumps(about, indent=2) + "\n").encode()
    return files


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    """Put files into a run's folder, each whole or not at all; LockedError where another trains there."""
    if not files:
        return
    with new_folder(folder), locked(folder, "training"):
        for name in sorted(files, key=lambda name: name == FINISHED):
            write_bytes(folder / name, files[name])
