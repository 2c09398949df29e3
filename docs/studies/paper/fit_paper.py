"""Search for a guess close to Table I: one setting at a time until none improves it, then from another guess."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich import box
from rich.table import Table

from dcgrid_env.apps.reproduction.load import choose_load
from dcgrid_env.apps.reproduction.study_runs import Runs, Setting
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.settings import at_least, check_folder
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.files import write_json
from dcgrid_env.core.versions import meta
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Place, Unit, shared
from docs.studies.paper.guess import LABELS, VALUES, Distance, Guess, cells, distance

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


SHOWN = 3
"""Settings that are printed; the file has all."""


@dataclass(frozen=True)
class FitPaper(OverWorkers):
    """Search for the values that the paper does not state.

    With these values the study comes close to the paper's Table I.

    A setting takes some 1.5 s of CPU time at 20 episodes. docs/reproduction.md compares the best of the search with
    the settings of the study.
    """

    tries: int = 231
    """Number of settings to try."""
    episodes: int = 20
    """Episodes for each cell, at least 2."""
    trace: str = "auto"
    """Load, as that of dcgrid reproduce."""
    out: Path = Path("results/fit-paper")
    """Folder for fit-paper.json, all settings in the order of the search."""

    def run(self) -> None:
        """Search, print the best, write all. Raise ValueError if a setting is invalid."""
        at_least(self, tries=1)
        setting = Setting(choose_load(self.trace), self.episodes)
        check_folder(self.out)
        place, console = self.place, plain_console()
        with progress_bar(console) as progress:
            bar = progress.add_task("settings", total=self.tries)
            trials = search(setting, self.tries, lambda trial: progress.update(bar, advance=1), place)
        rows = [trial.guess._asdict() | trial.distance._asdict() for trial in trials]
        write_json(self.out / "fit-paper.json", {"meta": meta(), "load": setting.load.description, "trials": rows})
        names = (*VALUES, "deviation_pu", "delay_s", "total")
        best = sorted(rows, key=lambda row: row["total"])[:SHOWN]
        head = ["", *(str(place) for place in range(1, len(best) + 1))]
        table = Table(*head, header_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for name in names:
            values = (row[name] for row in best)
            table.add_row(LABELS.get(name, name), *(f"{v:.4g}" if isinstance(v, float) else str(v) for v in values))
        console.print(table)
        say(console, f"wrote {self.out / 'fit-paper.json'}")
