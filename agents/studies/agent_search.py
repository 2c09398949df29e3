"""A search over an algorithm's settings for a scenario, judged on the validation split.

Optuna (T. Akiba et al., "Optuna: a next-generation hyperparameter optimization framework", arXiv 1907.10902) suggests
settings by its tree-structured Parzen estimator; a trial is a training, whose validations are reported to the median
pruner, which stops it where it lags behind the trials before. The first trial has the settings that a training begins
with anyway, so that what is found is no worse on these episodes. Trials are suggested in batches, whose trainings are
units of work. A trial's suggestions, and where it is stopped, depend on the search's seed, its own number and the
batches before alone: the same search gives the same trials, in one go or in several, on one core or on many machines,
as far as the trainings are the same to the last bit.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import json
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from dcgrid_env.agents import Card
from dcgrid_env.agents.studies.search_spaces import SPACES, Range, within
from dcgrid_env.agents.studies.training_runs import words_of
from dcgrid_env.agents.studies.training_units import train_all
from dcgrid_env.core.files import new_folder, write_json
from dcgrid_env.core.install import from_clone
from dcgrid_env.core.work.here import ONE_PROCESS
from dcgrid_env.core.work.unit import GOES_ON, Place

JOURNAL = "journal.log"
"""File of the trials, to which each is added when it has ended."""
TRIAL = "trial.json"
"""File in the folder of a trial's training: its costs on validation, whether it was stopped, and how long it took."""
NUMBER, SECONDS = "number", "seconds"
"""Attributes of a trial: its place in the order of suggestions, and how long it took."""
NO_SETTINGS = (
    "scenario", "set", "seed", "out", "resume", "threads", "device", "validation_episodes", "checkpoint_every",
)  # fmt: skip
"""Fields of a configuration that say what is trained, where and how it is judged, not how it learns."""
STARTUP_TRIALS, WARMUP_VALIDATIONS = 4, 1
"""Trials, and validations of each, before which none is stopped."""


def require_optuna() -> Any:
    """The module optuna; ValueError, saying how to install it, where it is missing."""
    try:
        return importlib.import_module("optuna")
    except ImportError as error:
        raise ValueError(f"tune-agent: {error}; install it {from_clone('search')}") from None


def search(
    base: Any,
    trials: int,
    seed: int,
    folder: Path,
    fixed: Collection[str] = (),
    on_trial: Callable[[Any], None] = lambda trial: None,
    batch: int = 1,
    place: Place = ONE_PROCESS,
) -> Any:
    """Add trials to a search until it has so many; the optuna study.

    Parameters
    ----------
    base
        Configuration of the algorithm.
    trials
        In all, those of an earlier call in the same folder included.
    seed
        Seed of the search; that of the trainings is the configuration's own.
    folder
        Where the journal and the trials' trainings are kept.
    fixed
        Fields that stay as they are in ``base``, beside those that have no space in ``SPACES``.
    on_trial
        Called after each trial with it.
    batch
        Trials that are suggested together, none of which knows what the others of them found. So many can be trained at
        once; what is found depends on it, and not on where and in which order they are trained.
    place
        Where they are trained.

    Raises
    ------
    ValueError
        For an algorithm without a space, a folder with the journal of another search, where optuna is missing, or for
        trials that cannot be done: when the others of their batch are.
    """
    optuna = require_optuna()
    algorithm = base.algorithm()
    if algorithm not in SPACES:
        raise ValueError(f"algorithm is {algorithm!r}; there are spaces for {', '.join(SPACES)}")
    space = {name: own for name, own in SPACES[algorithm].items() if name not in fixed}
    about = {**dataclasses.asdict(base), "seed of the search": seed, "batch": batch}
    about = {name: str(value) for name, value in about.items() if name not in ("out", "resume", *space)}
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with new_folder(folder):
        backend = optuna.storages.journal.JournalFileBackend(str(folder / JOURNAL))
        study = optuna.create_study(
            storage=optuna.storages.JournalStorage(backend), study_name=algorithm, load_if_exists=True
        )
        before = {"batch": "1"} | study.user_attrs.get("about", about)  # journals of earlier versions do not say
        if before != about:
            field = next(name for name in about if before.get(name) != about[name])
            raise ValueError(
                f"{folder / JOURNAL}: {field} was {before.get(field)} and is {about[field]} now; search with the same, "
                "or give another --out"
            )
        study.set_user_attr("about", about)
        begin = {name: getattr(base, name) for name, own in space.items() if within(own, getattr(base, name))}
        for first in range(0, trials, batch):
            earlier = [trial for trial in ended(study) if number_of(trial) < first]
            done = {number_of(trial) for trial in ended(study)}
            suggested = _suggestions(earlier, range(first, min(first + batch, trials)), space, begin, seed)
            todo = {folder / f"trial-{number:03d}": number for number in suggested if number not in done}
            configs = [dataclasses.replace(base, **suggested[todo[out]].params, out=out) for out in todo]
            lost: dict[int, str] = {}
            for config, failure in train_all(configs, place, partial(train_trial, earlier=earlier), words_of):
                number = todo[config.out]
                if failure is not None:
                    lost[number] = failure
                    continue
                study.add_trial(_result(suggested[number], number, config.out))
                on_trial(next(trial for trial in ended(study) if number_of(trial) == number))
            if lost:
                said = "; ".join(f"trial {number}: {lost[number]}" for number in sorted(lost))
                raise ValueError(f"{len(lost)} of {len(todo)} trainings failed: {said}; {GOES_ON}")
    return study


def ended(study: Any) -> list[Any]:
    """Trials that came to an end, or were stopped by the pruner, in their order; one that was interrupted is not."""
    return sorted((trial for trial in study.trials if trial.state.name in ("COMPLETE", "PRUNED")), key=number_of)


def number_of(trial: Any) -> int:
    """The number of a trial in the order in which they are suggested, which is not that in which they end."""
    return trial.user_attrs.get(NUMBER, trial.number)


def _suggestions(
    earlier: Sequence[Any], numbers: Iterable[int], space: Mapping[str, Any], begin: Mapping[str, Any], seed: int
) -> dict[int, Any]:
    """The trials of a batch by their numbers, suggested by what the earlier batches found and by their own seeds."""
    optuna = require_optuna()
    study = optuna.create_study()
    study.add_trials(earlier)
    found = {}
    for number in numbers:
        study.sampler = optuna.samplers.TPESampler(n_startup_trials=STARTUP_TRIALS, seed=1000 * seed + number)
        if number == 0:
            study.enqueue_trial(begin)
        trial = found[number] = study.ask()
        for name, own in space.items():
            _suggest(trial, name, own)
    return found


def _result(trial: Any, number: int, folder: Path) -> Any:
    """A trial that has ended, as its training's folder tells."""
    optuna = require_optuna()
    about = json.loads((folder / TRIAL).read_text(encoding="utf-8"))
    validations = dict(enumerate(about["validations"].values(), start=1))
    states = optuna.trial.TrialState
    value = validations[max(validations)] if validations else None
    return optuna.trial.create_trial(
        state=states.PRUNED if about["stopped"] else states.COMPLETE,
        value=value if about["stopped"] else Card.load(folder / "policy.json").validation_J,
        params=trial.params, distributions=trial.distributions, intermediate_values=validations,
        user_attrs={NUMBER: number, SECONDS: about["seconds"]},
    )  # fmt: skip


def train_trial(config: Any, earlier: Sequence[Any]) -> None:
    """Train with the settings of a trial until it ends, or lags behind the earlier trials; its folder tells which.

    Parameters
    ----------
    config
        Configuration of the training, with its folder, in which it goes on where it stopped.
    earlier
        The trials that it is held against.
    """
    from dcgrid_env.agents.training.run_folder import TrainingError, watched

    path, began_s = config.out / TRIAL, time.perf_counter()
    before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"validations": {}, "seconds": 0.0}
    costs = {int(step): cost for step, cost in before["validations"].items()}

    def keep(stopped: bool) -> None:
        spent_s = before["seconds"] + time.perf_counter() - began_s
        write_json(path, {"validations": costs, "stopped": stopped, "seconds": spent_s})

    def report(figures: Mapping[str, float]) -> None:
        nonlocal costs
        step = int(figures["step"])
        costs = {at: cost for at, cost in costs.items() if at < step} | {step: figures["J"]}
        keep(stopped=False)
        if _lags(list(costs.values()), earlier):
            raise _Stopped

    try:
        with watched(report), contextlib.redirect_stdout(io.StringIO()):
            begun = (config.out / "config.json").exists()
            importlib.import_module(type(config).__module__).main(dataclasses.replace(config, resume=begun))
    except (TrainingError, _Stopped):  # one that diverged has no cost, and is nothing to stop the search for
        keep(stopped=True)
    else:
        keep(stopped=False)


class _Stopped(Exception):
    """Ends a training that lags behind."""


def _lags(costs: Sequence[float], earlier: Sequence[Any]) -> bool:
    """Whether the median pruner stops a trial with these costs on validation so far."""
    optuna = require_optuna()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(pruner=optuna.pruners.MedianPruner(STARTUP_TRIALS, WARMUP_VALIDATIONS))
    study.add_trials(earlier)
    trial = study.ask()
    for i, cost in enumerate(costs, start=1):
        trial.report(cost, i)
    return trial.should_prune()


def _suggest(trial: Any, name: str, space: Any) -> None:
    if isinstance(space, Range):
        trial.suggest_float(name, space.low, space.high, log=space.log)
    else:
        trial.suggest_categorical(name, space.values)


def seconds(study: Any) -> float:
    """Time that all trials of a search took, training and validation, s."""
    return sum(trial.user_attrs.get(SECONDS, 0.0) for trial in study.trials)


def best_as_toml(study: Any, base: Any) -> str:
    """The best settings as they stand in agents/training/preset_settings.toml: what differs from the defaults."""
    import tomli_w

    best = dataclasses.replace(base, **study.best_trial.params)
    default = type(base)()
    own = {
        field.name: _rounded(getattr(best, field.name))
        for field in dataclasses.fields(base)
        if field.name not in NO_SETTINGS and getattr(best, field.name) != getattr(default, field.name)
    }
    return f"[{base.algorithm()}.{base.scenario}]\n{tomli_w.dumps(own)}".rstrip()


def _rounded(value: Any) -> Any:
    """A number with three figures: more than that a search does not tell."""
    return float(f"{value:.3g}") if isinstance(value, float) else value
