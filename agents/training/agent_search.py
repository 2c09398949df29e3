"""Search the settings of a training algorithm for a scenario, evaluated on the validation split.

Optuna suggests settings with its tree-structured Parzen estimator. A trial is a training. Its validations are reported
to the median pruner, which stops a trial that is worse than earlier trials. The first trial uses the settings with
which ``dcgrid train`` starts. The result is therefore at least as good on the validation episodes.

Trials are suggested in batches. Suggestions and pruning depend only on the seed of the search, the number of the trial
and the earlier batches. The search is therefore reproducible on any number of cores or machines, and in one call or
several, if the trainings are reproducible bit by bit.

Reference: T. Akiba et al., "Optuna: a next-generation hyperparameter optimization framework", arXiv 1907.10902.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from dcgrid_env.agents import Card
from dcgrid_env.agents.training.config import Training
from dcgrid_env.agents.training.search_spaces import SPACES, Range, within
from dcgrid_env.agents.training.training_runs import train_all, words_of
from dcgrid_env.agents.training.trial_training import STARTUP_TRIALS, read_trial, train_trial
from dcgrid_env.core.files import new_folder
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Place

if TYPE_CHECKING:
    import optuna

JOURNAL = "journal.log"
"""Name of the file to which each trial is added when it ends."""
NUMBER, SECONDS = "number", "seconds"
"""Names of trial attributes: position in the order of suggestions, and duration."""
NO_SETTINGS = (
    "scenario", "set", "seed", "out", "resume", "threads", "device", "validation_episodes", "checkpoint_every",
)  # fmt: skip
"""Configuration fields that define the task, the output and the evaluation, but not how the algorithm learns."""


def require_optuna() -> ModuleType:
    """Return the module optuna; raise ValueError with an installation hint if it is missing."""
    try:
        return importlib.import_module("optuna")
    except ImportError as error:
        raise ValueError(f"tune-agent: {error}; install it {from_clone('search')}") from None


def search(
    base: Training,
    trials: int,
    seed: int,
    folder: Path,
    fixed: Collection[str] = (),
    on_trial: Callable[[Any], None] = lambda trial: None,
    batch: int = 1,
    place: Place = ONE_PROCESS,
) -> Any:
    """Run trials until the search has the given number and return the optuna study.

    Parameters
    ----------
    base
        Configuration of the algorithm.
    trials
        Total number of trials, including those of earlier calls with the same folder.
    seed
        Seed of the search. The seed of the trainings is that of the configuration.
    folder
        Folder of the journal and of the trainings.
    fixed
        Fields that keep their value in ``base``, in addition to those without a search space in ``SPACES``.
    on_trial
        Function that is called with each completed trial.
    batch
        Number of trials that are suggested together, independently of each other's results, and can be trained in
        parallel. The result depends on this number, but not on where and in which order the trials are trained.
    place
        Where the trials are trained.

    Raises
    ------
    ValueError
        If the algorithm has no search space, the folder contains the journal of another search, or optuna is missing.
        If a trial fails, the error is raised after the other trials of its batch.
    """
    optuna = require_optuna()
    algorithm = base.algorithm()
    if algorithm not in SPACES:
        raise ValueError(f"algorithm is {algorithm!r}; there are spaces for {', '.join(SPACES)}")
    space = {name: choices for name, choices in SPACES[algorithm].items() if name not in fixed}
    about = {**dataclasses.asdict(base), "seed of the search": seed, "batch": batch}
    about = {name: str(value) for name, value in about.items() if name not in ("out", "resume", *space)}
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with new_folder(folder):
        study = _journal(folder / JOURNAL, algorithm)
        before = study.user_attrs.get("about", about)
        if before != about:
            field = next(name for name in {**before, **about} if before.get(name) != about.get(name))
            was, now = (said.get(field, "not said") for said in (before, about))
            raise ValueError(
                f"{folder / JOURNAL}: {field} was {was} and is {now} now; search with the same, or give another --out"
            )
        study.set_user_attr("about", about)
        begin = {name: getattr(base, name) for name, choices in space.items() if within(choices, getattr(base, name))}
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
                raise ValueError(f"{len(lost)} of {len(todo)} trainings failed, the others are kept: {said}")
    return study


def _journal(path: Path, algorithm: str) -> optuna.Study:
    """Return the search in a journal, or a new one; raise ValueError if the file is not a journal of this version."""
    optuna = require_optuna()
    try:
        backend = optuna.storages.journal.JournalFileBackend(str(path))
        storage = optuna.storages.JournalStorage(backend)
        study = optuna.create_study(storage=storage, study_name=algorithm, load_if_exists=True)
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: holds no search that can be read ({error}); give another --out") from None
    if any(NUMBER not in trial.user_attrs for trial in ended(study)):
        raise ValueError(f"{path}: is of an earlier version, which numbered trials otherwise; give another --out")
    return study


def ended(study: optuna.Study) -> list[Any]:
    """Return completed and pruned trials in order, without interrupted ones."""
    return sorted((trial for trial in study.trials if trial.state.name in ("COMPLETE", "PRUNED")), key=number_of)


def number_of(trial: optuna.trial.FrozenTrial) -> int:
    """Return the position of a trial in the order of suggestions, which can differ from the order of completion."""
    return trial.user_attrs.get(NUMBER, -1)


def _suggestions(
    earlier: Sequence[Any], numbers: Iterable[int], space: Mapping[str, Any], begin: Mapping[str, Any], seed: int
) -> dict[int, Any]:
    """Return the trials of a batch by number, suggested from earlier batches with a seed for each trial."""
    optuna = require_optuna()
    study = optuna.create_study()
    study.add_trials(earlier)
    found = {}
    for number in numbers:
        study.sampler = optuna.samplers.TPESampler(n_startup_trials=STARTUP_TRIALS, seed=1000 * seed + number)
        if number == 0:
            study.enqueue_trial(begin)
        trial = found[number] = study.ask()
        for name, choices in space.items():
            _suggest(trial, name, choices)
    return found


def _result(trial: optuna.trial.FrozenTrial, number: int, folder: Path) -> Any:
    """Return a completed trial from the output folder of its training."""
    optuna, told = require_optuna(), read_trial(folder)
    costs = dict(enumerate(told.costs.values(), start=1))
    states = optuna.trial.TrialState
    value = costs[max(costs)] if costs else None
    return optuna.trial.create_trial(
        state=states.PRUNED if told.stopped else states.COMPLETE,
        value=value if told.stopped else Card.load(folder / "policy.json").validation_J,
        params=trial.params, distributions=trial.distributions, intermediate_values=costs,
        user_attrs={NUMBER: number, SECONDS: told.seconds},
    )  # fmt: skip


def _suggest(trial: optuna.trial.FrozenTrial, name: str, space: Any) -> None:
    if isinstance(space, Range):
        trial.suggest_float(name, space.low, space.high, log=space.log)
    else:
        trial.suggest_categorical(name, space.values)


def seconds(study: optuna.Study) -> float:
    """Return the total time of all trials of a search, training and validation, s."""
    return sum(trial.user_attrs.get(SECONDS, 0.0) for trial in study.trials)


def best_as_toml(study: optuna.Study, base: Training) -> str:
    """Return the best settings that differ from the defaults, in the format of agents/training/preset_settings.toml."""
    import tomli_w

    best = dataclasses.replace(base, **study.best_trial.params)
    default = type(base)()
    changed = {
        field.name: _rounded(getattr(best, field.name))
        for field in dataclasses.fields(base)
        if field.name not in NO_SETTINGS and getattr(best, field.name) != getattr(default, field.name)
    }
    return f"[{base.algorithm()}.{base.scenario}]\n{tomli_w.dumps(changed)}".rstrip()


def _rounded(value: object) -> Any:
    """Round a number to three significant digits, the precision of a search."""
    return float(f"{value:.3g}") if isinstance(value, float) else value
