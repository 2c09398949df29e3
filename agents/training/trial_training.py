"""Train a trial of a search over settings and stop it if it is worse than earlier trials."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dcgrid_env.core.files import write_json
from dcgrid_env.core.user_files import read_json

TRIAL = "trial.json"
"""Name of the file with the :class:`TrialStatus` in the folder of a trial."""
STARTUP_TRIALS, WARMUP_VALIDATIONS = 4, 1
"""Minimum number of trials, and of validations of a trial, before a trial is stopped."""


@dataclasses.dataclass(frozen=True)
class TrialStatus:
    """Progress of a trial's training."""

    costs: dict[int, float] = dataclasses.field(default_factory=dict)
    """Validation J by training step."""
    stopped: bool = False
    """Whether the training was stopped or diverged."""
    seconds: float = 0.0
    """Computing time, s."""


def read_trial(folder: Path) -> TrialStatus:
    """Read the status of a trial, empty without a file; raise ValueError if the file is damaged."""
    path = folder / TRIAL
    if not path.exists():
        return TrialStatus()
    try:
        about = read_json(path, ValueError, "delete it")
        costs = {int(step): float(cost) for step, cost in about["costs"].items()}
        return TrialStatus(costs, bool(about["stopped"]), float(about["seconds"]))
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ValueError(f"{path}: does not say how the trial went; delete the folder {folder}") from None


def train_trial(config: Any, earlier: Sequence[Any]) -> None:
    """Train with the settings of a trial until completion or pruning; its folder stores the result.

    Parameters
    ----------
    config
        Configuration of the training. An interrupted training in its folder is resumed.
    earlier
        Earlier trials for comparison.
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
            again = dataclasses.replace(config, resume=begun, replay=False)
            importlib.import_module(type(config).__module__).main(again)
    except (Diverged, _Stopped):  # one that diverged has no cost, and is nothing to stop the search for
        keep(stopped=True)
    except BaseException:
        if config.out.exists():
            keep(stopped=False)  # for the time that it took
        raise
    else:
        keep(stopped=False)


class _Stopped(Exception):
    """Stop a training that is worse than earlier trials."""


def _lags(costs: Sequence[float], earlier: Sequence[Any]) -> bool:
    """Return whether the median pruner stops a trial with these validation costs."""
    optuna = importlib.import_module("optuna")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(pruner=optuna.pruners.MedianPruner(STARTUP_TRIALS, WARMUP_VALIDATIONS))
    study.add_trials(earlier)
    trial = study.ask()
    for i, cost in enumerate(costs, start=1):
        trial.report(cost, i)
    return trial.should_prune()
