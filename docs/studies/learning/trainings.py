"""What commands that train and test policies share: their settings, and doing trainings that have not been done."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from dcgrid_env.agents import Card, Policy
from dcgrid_env.agents.training.training_runs import LOG, finished, train_all
from dcgrid_env.core.commands.command import GOES_ON
from dcgrid_env.core.commands.progress import progress_bar
from dcgrid_env.core.commands.terminal import say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.work.unit import Place

MOST_EPISODES = 100
"""Test episodes whose hindsight is published, seeds 0 to 99."""


@dataclass(frozen=True)
class Study(OverWorkers):
    """A command that trains policies and tests them; trainings are kept, and what is done is not done again."""

    updates: int | None = None
    """Steps of the optimiser of each training; the algorithm's own default unless given."""
    seeds: int = 1
    """Number of training seeds, 0, 1, .., of all that is trained."""
    episodes: int = 100
    """Test episodes: seeds 0, 1, ..; at least 2, at most the published 100."""

    @property
    def resumes(self) -> str:
        """Return how to resume: finished runs are not repeated."""
        return GOES_ON

    def settings(self, **others: Any) -> dict[str, Any]:
        """Return the settings of all trainings; raise ValueError for an invalid one."""
        for field in ("updates", "seeds"):
            value = getattr(self, field)
            if value is not None and value < 1:
                raise ValueError(f"{field} is {value}; give at least 1")
        if not 2 <= self.episodes <= MOST_EPISODES:
            raise ValueError(f"episodes is {self.episodes}; give 2 to {MOST_EPISODES}, the published test episodes")
        return others if self.updates is None else {"updates": self.updates, **others}


def positive_numbers(field: str, text: str) -> list[float]:
    """Figures above 0 separated by commas, each once, rising; ValueError, naming the field, for anything else."""
    try:
        values = sorted({float(part) for part in text.split(",") if part.strip()})
    except ValueError:
        values = []
    if not values or not all(math.isfinite(value) and value > 0 for value in values):
        raise ValueError(f"{field} is {text!r}; give figures above 0, separated by commas")
    return values


def do_trainings(configs: Iterable[Any], place: Place, console: Console) -> dict[Path, str]:
    """Do the runs that have not been done, several at once; those that failed, by folder, with why."""

    asked = list(configs)
    due = [config for config in asked if not finished(config)]
    if len(due) < len(asked):
        say(console, f"{len(asked) - len(due)} of {len(asked)} trainings are done already with these settings")
    failures: dict[Path, str] = {}
    if not due:
        return failures
    say(console, f"the first: {due[0].out / LOG}")
    with progress_bar(console) as progress:
        bar = progress.add_task("trainings", total=len(asked), completed=len(asked) - len(due))
        for config, failure in train_all(due, place):
            if failure is not None:
                failures[config.out] = failure
                say(console, f"failed: {failure}")
            progress.advance(bar)
    return failures


def trained(config: Any) -> tuple[Policy, Card]:
    """The policy of a finished run, the best on validation, and its card."""
    return Policy.load(config.out / "policy.safetensors"), Card.load(config.out / "policy.json")


def folder(runs: Path, scenario: str, label: str, updates: int, seed: int) -> Path:
    """Return the folder of a run; its name contains the command-line settings, so each run has its own."""
    return runs / scenario.replace(",", "+") / f"{label}-{updates}-{seed}"
