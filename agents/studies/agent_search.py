"""A search over an algorithm's settings for a scenario, judged on the validation split.

Optuna (T. Akiba et al., "Optuna: a next-generation hyperparameter optimization framework", arXiv 1907.10902) suggests
settings by its tree-structured Parzen estimator; a trial is a training, whose validations are reported to the median
pruner, which stops it where it lags behind the trials before. The first trial has the settings that a training begins
with anyway, so that what is found is no worse on these episodes. A trial's suggestions depend on the search's seed, its
own number and the trials before it alone: the same search gives the same trials, in one go or in several, as far as the
trainings are the same to the last bit.
"""

from __future__ import annotations

import dataclasses
import importlib
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from dcgrid_env.agents import Card
from dcgrid_env.agents.studies.search_spaces import SPACES, Range, within
from dcgrid_env.core.files import new_folder
from dcgrid_env.core.install import from_clone

JOURNAL = "journal.log"
"""File of the trials, to which each is added as it goes."""
SECONDS = "seconds"
"""Attribute of a trial: how long it took."""
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

    Raises
    ------
    ValueError
        For an algorithm without a space, a folder with the journal of another search, or where optuna is missing.
    """
    optuna = require_optuna()
    algorithm = base.algorithm()
    if algorithm not in SPACES:
        raise ValueError(f"algorithm is {algorithm!r}; there are spaces for {', '.join(SPACES)}")
    space = {name: own for name, own in SPACES[algorithm].items() if name not in fixed}
    about = {**dataclasses.asdict(base), "seed of the search": seed}
    about = {name: str(value) for name, value in about.items() if name not in ("out", "resume", *space)}
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with new_folder(folder):
        backend = optuna.storages.journal.JournalFileBackend(str(folder / JOURNAL))
        study = optuna.create_study(
            storage=optuna.storages.JournalStorage(backend), study_name=algorithm, load_if_exists=True,
            pruner=optuna.pruners.MedianPruner(STARTUP_TRIALS, WARMUP_VALIDATIONS),
        )  # fmt: skip
        before = study.user_attrs.get("about", about)
        if before != about:
            field = next(name for name in about if before.get(name) != about[name])
            raise ValueError(
                f"{folder / JOURNAL}: {field} was {before.get(field)} and is {about[field]} now; search with the same, "
                "or give another --out"
            )
        study.set_user_attr("about", about)
        begin = {name: getattr(base, name) for name, own in space.items() if within(own, getattr(base, name))}
        for number in range(len(ended(study)), trials):
            study.sampler = optuna.samplers.TPESampler(n_startup_trials=STARTUP_TRIALS, seed=1000 * seed + number)
            if number == 0 and not any(trial.state.name == "WAITING" for trial in study.trials):
                study.enqueue_trial(begin)
            place = folder / f"trial-{number:03d}"
            study.optimize(lambda trial, place=place: _cost(trial, base, space, place, optuna), n_trials=1)
            on_trial(ended(study)[-1])
    return study


def ended(study: Any) -> list[Any]:
    """Trials that came to an end, or were stopped by the pruner; one that was interrupted is done again."""
    return [trial for trial in study.trials if trial.state.name in ("COMPLETE", "PRUNED")]


def _cost(trial: Any, base: Any, space: Mapping[str, Any], folder: Path, optuna: Any) -> float:
    """Train with the settings that are suggested; the best cost on validation."""
    from dcgrid_env.agents.training.run_folder import TrainingError, watched

    chosen = {name: _suggested(trial, name, own) for name, own in space.items()}
    config = dataclasses.replace(base, **chosen, out=folder, resume=folder.exists())
    validations = 0

    def report(figures: Mapping[str, float]) -> None:
        nonlocal validations
        validations += 1
        trial.report(figures["J"], validations)
        if trial.should_prune():
            raise optuna.TrialPruned

    began_s = time.perf_counter()
    try:
        with watched(report):
            importlib.import_module(type(config).__module__).main(config)
    except TrainingError:  # it diverged: no cost, and nothing to stop the search for
        raise optuna.TrialPruned from None
    finally:
        trial.set_user_attr(SECONDS, time.perf_counter() - began_s)
    cost = Card.load(folder / "policy.json").validation_J
    assert cost is not None
    return cost


def _suggested(trial: Any, name: str, space: Any) -> Any:
    if isinstance(space, Range):
        return trial.suggest_float(name, space.low, space.high, log=space.log)
    return trial.suggest_categorical(name, space.values)


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
