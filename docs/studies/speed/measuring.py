"""Measurement of a rate, and the output line for it."""

from __future__ import annotations

import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

ROOT = Path(__file__).parents[3]
"""The repository, in which a further process finds ``docs.studies``."""
BLOCKS = 7  # timed blocks behind a median; fewer where one call outlasts its share of the time


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    value: float | None
    """None where a library is not installed, or a batch does not fit into memory."""
    unit: str
    error_pu: float | None = None
    """Worst difference of a bus voltage, p.u., to a solve at a far finer tolerance; None where there is none."""


def rate(work: Callable[[], object], amount: float, seconds: float, clock: Callable[[], float] = perf_counter) -> float:
    """How much of something ``work`` does in a second if one call does ``amount``: the median of timed blocks."""
    work()
    calls, start = 0, clock()
    while calls == 0 or clock() - start < 0.1 * seconds:
        work()
        calls += 1
    once = (clock() - start) / calls
    blocks = int(np.clip(seconds / once, 3, BLOCKS))
    repeats = range(max(1, int(seconds / blocks / once)))
    spent = []
    for _ in range(blocks):
        start = clock()
        for _ in repeats:
            work()
        spent.append(clock() - start)
    return amount * len(repeats) / statistics.median(spent)
