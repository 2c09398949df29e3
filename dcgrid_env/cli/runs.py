"""Episodes under several controllers, kept whole or, where they are too long for that, recorded in parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcgrid_env.cli.terminal import say, working

if TYPE_CHECKING:
    from rich.console import Console

    from dcgrid_env import Scenario
    from dcgrid_env.baselines import Controller


class Runs:
    """Runs controllers on the same episodes and keeps what a table and a figure take.

    Parameters
    ----------
    scenario, seeds
        The episodes.
    course
        "auto", "parquet" or "none", see ``dcgrid run``.
    out
        Where the course of each controller is written, in a folder ``course``.
    console
        Where to say that episodes are recorded in parts.

    Raises
    ------
    ValueError
        Where the course is to be written and pyarrow is missing; before anything is run.
    """

    def __init__(self, scenario: Scenario, seeds: Sequence[int], course: str, out: Path, console: Console):
        from dcgrid_env import WHOLE_COURSE_BYTES, course_bytes
        from dcgrid_env.engine.record.parquet import require_pyarrow

        self.scenario, self.seeds, self.out = scenario, seeds, out
        with working(console, "making the traces"):
            size = course_bytes(scenario, seeds)
        self.in_parts = size > WHOLE_COURSE_BYTES
        """Whether the course is too large to be kept."""
        self.writes = course == "parquet" or (course == "auto" and self.in_parts)
        self.metrics: dict[str, list[dict[str, float]]] = {}
        """Figures of each episode, by controller."""
        self.folders: list[Path] = []
        """Where the course of each controller has been written."""
        self._drawn: dict[str, Any] = {}
        if self.writes:
            try:
                require_pyarrow()
            except ValueError as error:
                raise ValueError(f"{error}, or add --course none") from None
        if self.in_parts:
            scenario.member(seeds)  # refuses episodes on several random feeders
            where = f"the course goes to {out / 'course'}" if self.writes else "the course is not written"
            say(
                console,
                f"{len(seeds)} x {scenario.horizon:,} steps would take {size / 2**20:,.0f} MiB a controller (more than "
                f"{WHOLE_COURSE_BYTES // 2**20}): figures are summed up as the episodes run, and {where}",
            )

    def add(self, name: str, controller: Controller, on_step: Callable[[], None]) -> None:
        """Run a controller."""
        from dcgrid_env import ParquetCourse
        from dcgrid_env.baselines import rollout, streaming_rollout
        from dcgrid_env.baselines.controller import with_figures
        from dcgrid_env.baselines.file_names import file_name
        from dcgrid_env.rendering import Envelope

        with ExitStack() as stack:
            sinks: list[Any] = []
            if self.writes:
                self.folders.append(self.out / "course" / file_name(name))
                sinks.append(stack.enter_context(ParquetCourse(self.folders[-1], self.scenario, self.seeds)))
            if self.in_parts:
                self._drawn[name] = Envelope(self.scenario)
                sinks.append(self._drawn[name])
                run = streaming_rollout(self.scenario, controller, self.seeds, sinks, on_step, name)
            else:
                run = rollout(self.scenario, controller, self.seeds, on_step, name)
                self._drawn[name] = run.lane(0)
                for sink in sinks:
                    sink.add([run.lane(i) for i in range(len(self.seeds))], 0)
            self.metrics[name] = with_figures(controller, run.metrics())

    def draw(self, path: Path) -> None:
        """Draw the first episode under each controller."""
        from dcgrid_env.core.files import write_figure
        from dcgrid_env.rendering import long_figure, run_figure

        draw = long_figure if self.in_parts else run_figure
        write_figure(path, draw(self.scenario.member(self.seeds[0]), self._drawn, self.seeds[0]), dpi=130)


def draw_first(
    scenario: Scenario, seed: int, controllers: Mapping[str, Controller], out: Path, console: Console
) -> Path:
    """Draw one episode under several controllers, side by side, and write it to figure.png in a folder; its path."""
    runs = Runs(scenario, [seed], "none", out, console)
    for name, controller in controllers.items():
        runs.add(name, controller, lambda: None)
    runs.draw(out / "figure.png")
    return out / "figure.png"
