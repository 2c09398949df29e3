"""The command ``dcgrid dev unit-overhead``."""

from __future__ import annotations

from dataclasses import dataclass

from dcgrid_env.cli.settings import at_least
from dcgrid_env.cli.terminal import plain_console, say
from dcgrid_env.cli.workers import OverWorkers, place


@dataclass(frozen=True)
class UnitOverhead(OverWorkers):
    """Measure the overhead of units of work.

    Measures it on this machine and, with --ray, on a cluster.

    Units of about --seconds of CPU time are run one at a time and on all workers, and units without work by the
    hundred; times are the least of --repeats. How long many units take on many workers is simulated from that.
    """

    units: int = 4
    """Number of the long units."""
    seconds: float = 10.0
    """CPU time of each, s."""
    repeats: int = 3
    """How often all is measured."""

    def run(self) -> None:
        """Measure and print. ValueError for a setting that cannot be."""
        from rich.table import Table

        from dcgrid_env.speed.unit_overhead import overheads, simulated_s

        at_least(self, units=1, seconds=0.001, repeats=1)
        places = [("this machine", place(self.workers, None))]
        if self.ray is not None:
            places.append(("Ray", place(None, self.ray)))
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
        for workers in (1, 2, 8, 32, 128, 512):
            times = (simulated_s(one, 1000, self.seconds, workers) for one in found)
            simulated.add_row(f"{workers} workers", *(f"{t:.0f} s, {1000 * self.seconds / t:.1f} times" for t in times))
        console.print(simulated)
