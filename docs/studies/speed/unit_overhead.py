"""What it costs to have units of work done elsewhere: starting, a message, and the whole of a few long units."""

from __future__ import annotations

import itertools
import math
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table

from dcgrid_env.core.commands import workers
from dcgrid_env.core.commands.settings import at_least
from dcgrid_env.core.commands.terminal import plain_console, say
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.work.unit import Lost, Needs, Place, Unit

EMPTY = 400
"""Units without work by which messages are timed."""


@dataclass(frozen=True)
class Overhead:
    """Times measured in one place; each is the least of several, as other processes can only add to it."""

    name: str
    begin_s: float
    """Time from the call to the first result of a unit without work, s: workers start and import the package."""
    message_s: float
    """Time for each further unit without work, s, all workers together: the cost of handing out a unit."""
    wall_s: tuple[float, float]
    """Time of the long units one at a time and on all workers, s, without the time to begin."""
    between_s: float
    """Mean time from the end of a long unit to the beginning of the next on that worker, s: the overhead of a unit,
    independent of the speed of the cores."""


def spin(steps: int) -> int:
    """Work of one core that touches no memory to speak of."""
    x = 1
    for _ in range(steps):
        x = (x * 1103515245 + 12345) & 0x7FFFFFFF
    return x


def timed_spin(steps: int) -> tuple[int, float, float]:
    """``spin`` in which process, from when to when by the machine's clock, s."""
    began = time.time()
    spin(steps)
    return os.getpid(), began, time.time()


def steps_of(seconds: float) -> int:
    """Steps of ``spin`` that take about so many seconds of CPU time."""
    steps, best = 2_000_000, math.inf
    for _ in range(3):
        began = time.process_time()
        spin(steps)
        best = min(best, time.process_time() - began)
    return int(steps * seconds / best)


def overheads(places: Sequence[tuple[str, Place]], units: int, seconds: float, repeats: int) -> list[Overhead]:
    """Measure places in turn, again and again, so that a busy minute is not one place's alone.

    Parameters
    ----------
    places
        With their names, each of the same number of workers.
    units
        How many long units there are.
    seconds
        CPU time of each, about.
    repeats
        How often all is done; the least time counts.
    """
    steps = steps_of(seconds)
    times: dict[str, list[tuple[float, ...]]] = {name: [] for name, _ in places}
    for _ in range(repeats):
        for name, place in places:
            begin_s, message_s = _messages(place)
            alone_s, between_s = _long(place, units, steps, float(place.workers))
            times[name].append((begin_s, message_s, alone_s, _long(place, units, steps, 1.0)[0], between_s))
    found = []
    for name, measured in times.items():
        begin_s, message_s, alone_s, all_s, between_s = (min(column) for column in zip(*measured, strict=True))
        found.append(Overhead(name, begin_s, message_s, (alone_s, all_s), between_s))
    return found


def _messages(place: Place) -> tuple[float, float]:
    began = time.perf_counter()
    results = place.run([Unit(str(i), spin, 0) for i in range(EMPTY)])
    next(results)
    first = time.perf_counter()
    for _ in results:
        pass
    return first - began, (time.perf_counter() - first) / (EMPTY - 1)


def _long(place: Place, units: int, steps: int, cores: float) -> tuple[float, float]:
    """Wall time of long units after one without work on each worker, and the mean time between two of a worker, s."""
    warm = [Unit(f"warm {i}", timed_spin, 0, Needs(cores)) for i in range(place.workers)]
    work = [Unit(str(i), timed_spin, steps, Needs(cores)) for i in range(units)]
    results = place.run([*warm, *work])
    for _ in warm:
        next(results)
    began = time.perf_counter()
    done = sorted(result for _, result in results if not isinstance(result, Lost))
    wall_s = time.perf_counter() - began
    gaps = [b[1] - a[2] for a, b in itertools.pairwise(done) if a[0] == b[0]]
    return wall_s, sum(gaps) / len(gaps) if gaps else math.nan


def simulated_s(overhead: Overhead, units: int, seconds: float, workers: int) -> float:
    """Simulate the wall time of many units on many workers, s, from the measured overhead.

    One process hands out the units one after the other, in ``message_s`` each, to the worker that is free first. The
    worker begins the unit ``between_s`` later. All workers are ready at once, after ``begin_s``. The simulation
    ignores network and file system.
    """
    handed, free = 0.0, [overhead.begin_s] * workers
    for i in range(units):
        handed += overhead.message_s
        # All units last as long, so that workers become free in the order in which they were given work.
        free[i % workers] = max(handed, free[i % workers]) + overhead.between_s + seconds
    return max(free)


@dataclass(frozen=True)
class UnitOverhead(OverWorkers):
    """Measure the overhead of units of work.

    The command runs on this machine and, with --ray, on a cluster.

    Units of about --seconds of CPU time run one at a time and on all workers, and units without work by the hundred.
    Times are the least of --repeats. The time of many units on many workers is simulated from these measurements.
    """

    units: int = 4
    """Number of the long units."""
    seconds: float = 10.0
    """CPU time of each, s."""
    repeats: int = 3
    """Number of repetitions of all measurements."""

    def run(self) -> None:
        """Measure and print. ValueError for an invalid setting."""
        at_least(self, units=1, seconds=0.001, repeats=1)
        places = [("this machine", workers.place(self.workers, None))]
        if self.ray is not None:
            places.append(("Ray", workers.place(None, self.ray)))
        n = places[0][1].workers
        if n < 2 or any(other.workers != n for _, other in places):
            raise ValueError(f"workers is {n}; give at least 2, and as many as the cluster has cores")
        found = overheads(places, self.units, self.seconds, self.repeats)
        head = ("first result, s", "message, ms", "between, ms", "one at a time, s", f"on {n} workers, s", "speed-up")
        measured = Table("measured", *head)
        for one in found:
            alone, together = one.wall_s
            figures = (one.begin_s, 1e3 * one.message_s, 1e3 * one.between_s, alone, together, alone / together)
            measured.add_row(one.name, *(f"{figure:.2f}" for figure in figures))
        console = plain_console()
        console.print(measured)
        if len(found) > 1:
            here, there = found
            more = [100.0 * (b / a - 1.0) for a, b in zip(here.wall_s, there.wall_s, strict=True)]
            between = 100.0 * (there.between_s - here.between_s) / self.seconds
            say(
                console,
                f"Ray beside this machine: {more[0]:+.1f} % one at a time, {more[1]:+.1f} % on {n} workers; by the",
            )
            say(
                console,
                f"time between units, which other processes disturb less, {between:+.2f} % of {self.seconds:g} s",
            )
        simulated = Table(f"simulated: 1,000 units of {self.seconds:g} s", *(one.name for one in found))
        for n_workers in (1, 2, 8, 32, 128, 512):
            times = (simulated_s(one, 1000, self.seconds, n_workers) for one in found)
            simulated.add_row(
                f"{n_workers} workers", *(f"{t:.0f} s, {1000 * self.seconds / t:.1f} times" for t in times)
            )
        console.print(simulated)
