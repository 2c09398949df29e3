"""The training of a trial in a search over settings, stopped where it lags behind earlier trials; its folder tells how
it went.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dcgrid_env.core.files import write_json

TRIAL = "trial.json"
"""File in the folder of a trial's training: what :class:`TrialStatus` holds."""
STARTUP_TRIALS, WARMUP_VALIDATIONS = 4, 1
"""Trials, and validations of each, before which none is stopped."""


@dataclasses.dataclass(frozen=True)
class TrialStatus:
    """How a trial's training went so far."""

    costs: dict[int, float] = dataclasses.field(default_factory=dict)
    """J on validation by the training's own step."""
    stopped: bool = False
    """Whether it was stopped, or diverged."""
    seconds: float = 0.0
    """Time that it took."""


def read_trial(folder: Path) -> TrialStatus:
    """How the training in a folder went; nothing yet where there is no file, ValueError for one that is damaged."""
    path = folder / TRIAL
    if not path.exists():
        return TrialStatus()
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        costs = {int(step): float(cost) for step, cost in about["costs"].items()}
        return TrialStatus(costs, bool(about["stopped"]), float(about["seconds"]))
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ValueError(f"{path}: does not say how the trial went; delete the folder {folder}") from None


def train_trial(config: Any, earlier: Sequence[Any]) -> None:
    """Train with the settings of a trial until it ends, or lags behind the earlier trials; its folder tells which.

    Parameters
    ----------
    config
        Configuration of the training, with its folder, in which it goes on where it stopped.
    earlier
        The trials that it is held against.
    """
    from dcgrid_env.agents.training.run_folder import Diverged, watched

    before, began_s = read_trial(config.out), time.perf_counter()
    costs = before.costs

    def keep(stopped: bool) -> None:
        spent_s = before.seconds + time.perf_counter() - began_s
        write_json(config.out / TRIAL, dataclasses.asdict(TrialStatus(costs, stopped, spent_s)))

    def report(figures: Mapping[str, float]) -> None:
        nonlocal costs
        step = int(figures["step"])
        costs = {at_step: cost for at_step, cost in costs.items() if at_step < step} | {step: figures["J"]}
        keep(stopped=False)
        if _lags(list(costs.values()), earlier):
            raise _Stopped

    try:
        with watched(report), contextlib.redirect_stdout(io.StringIO()):
            begun = (config.out / "config.json").exists()
            importlib.import_module(type(config).__module__).main(dataclasses.replace(config, resume=begun))
    except (Diverged, _Stopped):  # one that diverged has no cost, and is nothing to stop the search for
        keep(stopped=True)
    except BaseException:
        if config.out.exists():
            keep(stopped=False)  # for the time that it took
        raise
    else:
        keep(stopped=False)


class _Stopped(Exception):
    """Ends a training that lags behind."""


def _lags(costs: Sequence[float], earlier: Sequence[Any]) -> bool:
    """Whether the median pruner stops a trial with these costs on validation so far."""
    optuna = importlib.import_module("optuna")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(pruner=optuna.pruners.MedianPruner(STARTUP_TRIALS, WARMUP_VALIDATIONS))
    study.add_trials(earlier)
    trial = study.ask()
    for i, cost in enumerate(costs, start=1):
        trial.report(cost, i)
    return trial.should_prune()
