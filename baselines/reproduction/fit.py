"""Search for a guess close to Table I: one setting at a time until none improves it, then from another guess."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dcgrid_env.baselines.reproduction.guess import VALUES, Distance, Guess, cells, distance
from dcgrid_env.baselines.reproduction.study_runs import Runs, Setting
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Place, Unit
from dcgrid_env.core.work.worker import shared

_SETTING = "setting of the search"


class Trial(NamedTuple):
    """A guess that was tried."""

    guess: Guess
    distance: Distance


def search(
    setting: Setting, most: int, on_trial: Callable[[Trial], None] = lambda trial: None, place: Place = ONE_PROCESS
) -> list[Trial]:
    """Improve the study's own settings one at a time until none improves, then start at a random guess.

    Parameters
    ----------
    setting
        Load and episodes.
    most
        How many guesses are tried.
    on_trial
        Called with each trial.
    place
        Where the guesses are tried.

    Returns
    -------
    All trials in the order of the search.
    """
    found: dict[Guess, Trial] = {}
    random = np.random.default_rng(0)

    def best_of(guesses: list[Guess]) -> Guess:
        new = [guess for guess in dict.fromkeys(guesses) if guess not in found][: most - len(found)]
        units = [Unit(str(tuple(guess)), _try, guess) for guess in new]
        done: dict[Guess, Trial] = {}
        for unit, result in place.results(units, {_SETTING: setting}, how_to_go_on=""):
            done[unit.item] = Trial(unit.item, result)
            on_trial(done[unit.item])
        found.update({guess: done[guess] for guess in new})
        return min((g for g in guesses if g in found), key=lambda g: found[g].distance.total)

    start = Guess()
    while len(found) < most:
        best, before = best_of([start]), None
        while best != before and len(found) < most:
            before = best
            for name, values in VALUES.items():
                best = best_of([best, *(best._replace(**{name: value}) for value in values)])
        start = Guess(**{name: values[random.integers(len(values))] for name, values in VALUES.items()})
    return list(found.values())


def _try(guess: Guess) -> Distance:
    """Compute the distance of a guess from Table I."""
    return distance(cells(Runs(shared(_SETTING)), guess))
