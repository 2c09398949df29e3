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

import dataclasses
import importlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from dcgrid_env.agents import Card
from dcgrid_env.agents.training.search_spaces import SPACES, Range, within
from dcgrid_env.agents.training.training_runs import train_all, words_of
from dcgrid_env.agents.training.trial_training import STARTUP_TRIALS, read_trial, train_trial
from dcgrid_env.core.files import new_folder
from dcgrid_env.core.install import from_clone
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Place

JOURNAL = "journal.log"
"""File of the trials, to which each is added when it has ended."""
NUMBER, SECONDS = "number", "seconds"
"""Attributes of a trial: its place in the order of suggestions, and how long it took."""
NO_SETTINGS = (
    "scenario", "set", "seed", "out", "resume", "threads", "device", "validation_episodes", "checkpoint_every",
)  # fmt: skip
"""Fields of a configuration that say what is trained, where and how it is judged, not how it learns."""


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


def _journal(path: Path, algorithm: str) -> Any:
    """The search that a journal holds, or a new one; ValueError for what is no journal of this version."""
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


def ended(study: Any) -> list[Any]:
    """Trials that came to an end, or were stopped by the pruner, in their order; one that was interrupted is not."""
    return sorted((trial for trial in study.trials if trial.state.name in ("COMPLETE", "PRUNED")), key=number_of)


def number_of(trial: Any) -> int:
    """The number of a trial in the order in which they are suggested, which is not that in which they end."""
    return trial.user_attrs.get(NUMBER, -1)


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
        for name, choices in space.items():
            _suggest(trial, name, choices)
    return found


def _result(trial: Any, number: int, folder: Path) -> Any:
    """A trial that has ended, as its training's folder tells."""
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
    changed = {
        field.name: _rounded(getattr(best, field.name))
        for field in dataclasses.fields(base)
        if field.name not in NO_SETTINGS and getattr(best, field.name) != getattr(default, field.name)
    }
    return f"[{base.algorithm()}.{base.scenario}]\n{tomli_w.dumps(changed)}".rstrip()


def _rounded(value: Any) -> Any:
    """A number with three figures: more than that a search does not tell."""
    return float(f"{value:.3g}") if isinstance(value, float) else value
