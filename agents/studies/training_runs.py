"""Training runs that belong together: each in a folder of its own, resumed where it stopped, and not done again.

A run is a training configuration with its folder, ``out``. When it is over, its settings are left there in
``finished.json``; what it says while it trains goes into ``training.log``.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

from dcgrid_env.agents import Card, Policy
from dcgrid_env.core.files import new_folder, write_json

FINISHED, LOG = "finished.json", "training.log"
PLACES = ("out", "resume")
"""Fields of a configuration that say where and how it is run, not what comes out."""


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
    """The words of that command without ``dcgrid``, as a policy's card is to name it."""
    return shlex.split(command(config))[1:]


def finished(config: Any) -> bool:
    """Whether the run has been done, with exactly these settings."""
    try:
        return json.loads((config.out / FINISHED).read_text(encoding="utf-8")) == _settings(config)
    except (OSError, ValueError):
        return False


def train(config: Any) -> str | None:
    """Do a run, or what is left of it; why it failed, if it did.

    Only what the run itself reports as a failure (it diverged, its folder holds another run) is returned; all else is
    raised.
    """
    from dcgrid_env.agents.training.run_folder import TrainingError

    try:
        with new_folder(config.out), _log(config.out / LOG) as log, contextlib.redirect_stdout(log):
            begun = (config.out / "config.json").exists()
            importlib.import_module(type(config).__module__).main(dataclasses.replace(config, resume=begun))
    except TrainingError as error:
        return str(error)
    write_json(config.out / FINISHED, _settings(config))
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


def train_seed(config: Any) -> str | None:
    """Do a run, going on where it stopped; why it failed, if it did.

    What it says is not shown.
    """
    from dcgrid_env.agents.training.run_folder import TrainingError

    try:
        with contextlib.redirect_stdout(io.StringIO()):
            importlib.import_module(type(config).__module__).main(dataclasses.replace(config, resume=True))
    except TrainingError as error:
        return str(error)
    return None


def trained(config: Any) -> tuple[Policy, Card]:
    """The policy of a finished run, the best on validation, and its card."""
    return Policy.load(config.out / "policy.safetensors"), Card.load(config.out / "policy.json")


def folder(runs: Path, scenario: str, label: str, updates: int, seed: int) -> Path:
    """Where a run is kept: settings that are given on the command line stand in its name, so that none meet."""
    return runs / scenario.replace(",", "+") / f"{label}-{updates}-{seed}"


def _settings(config: Any) -> dict[str, Any]:
    about = {name: value for name, value in dataclasses.asdict(config).items() if name not in PLACES}
    return json.loads(json.dumps(about, default=str))
