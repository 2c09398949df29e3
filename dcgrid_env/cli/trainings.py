"""Training runs that a command needs: what they are made of, and doing those that have not been done."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcgrid_env.cli.progress import progress_bar
from dcgrid_env.cli.settings import processes
from dcgrid_env.cli.terminal import say

if TYPE_CHECKING:
    from rich.console import Console

MOST_EPISODES = 100
"""Test episodes whose hindsight is published, seeds 0 to 99."""


def chosen(updates: int | None, seeds: int, episodes: int, **others: Any) -> dict[str, Any]:
    """Settings of all the trainings of a command; ValueError for one that cannot be."""
    for field, value in (("updates", updates), ("seeds", seeds)):
        if value is not None and value < 1:
            raise ValueError(f"{field} is {value}; give at least 1")
    if not 2 <= episodes <= MOST_EPISODES:
        raise ValueError(f"episodes is {episodes}; give 2 to {MOST_EPISODES}, the published test episodes")
    return others if updates is None else {"updates": updates, **others}


def positive_numbers(field: str, text: str) -> list[float]:
    """Figures above 0 separated by commas, each once, rising; ValueError, naming the field, for anything else."""
    try:
        values = sorted({float(part) for part in text.split(",") if part.strip()})
    except ValueError:
        values = []
    if not values or not all(math.isfinite(value) and value > 0 for value in values):
        raise ValueError(f"{field} is {text!r}; give figures above 0, separated by commas")
    return values


def do(configs: Iterable[Any], jobs: int | None, console: Console) -> dict[Path, str]:
    """Do the runs that have not been done, several at once; those that failed, by folder, with why.

    ValueError for jobs that cannot be.
    """
    from dcgrid_env.agents.studies.training_runs import LOG, finished, train_all

    n, asked = processes(jobs), list(configs)
    due = [config for config in asked if not finished(config)]
    if len(due) < len(asked):
        say(console, f"{len(asked) - len(due)} of {len(asked)} trainings are done already with these settings")
    failures: dict[Path, str] = {}
    if not due:
        return failures
    say(console, f"the first: {due[0].out / LOG}")
    with progress_bar(console) as progress:
        bar = progress.add_task("trainings", total=len(asked), completed=len(asked) - len(due))
        for config, failure in train_all(due, n):
            if failure is not None:
                failures[config.out] = failure
                say(console, f"failed: {failure}")
            progress.advance(bar)
    return failures
