"""Run episodes under several controllers; keep them in memory, or stream them if they are too long."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcgrid_env.core.commands.terminal import say, working

if TYPE_CHECKING:
    from rich.console import Console

    from dcgrid_env import Scenario
    from dcgrid_env.baselines import Controller


class Runs:
    """Run controllers on the same episodes and keep the data for a table and a figure.

    Parameters
    ----------
    scenario, seeds
        The episodes.
    course
        "auto", "parquet" or "none", see ``dcgrid run``.
    out
        Output folder; trajectories go to its sub-folder ``course``.
    console
        Console for the message that episodes are streamed.

    Raises
    ------
    ValueError
        If trajectories are to be written and pyarrow is missing; raised before any run.
    """

    def __init__(self, scenario: Scenario, seeds: Sequence[int], course: str, out: Path, console: Console):
        from dcgrid_env import WHOLE_COURSE_BYTES, ParquetCourse, course_bytes

        self.scenario, self.seeds, self.out = scenario, seeds, out
        with working(console, "generating traces"):
            size = course_bytes(scenario, seeds)
        self.in_parts = size > WHOLE_COURSE_BYTES
        """Whether the trajectories are too large for memory."""
        self.writes = course == "parquet" or (course == "auto" and self.in_parts)
        self.metrics: dict[str, list[dict[str, float]]] = {}
        """Metrics of each episode, by controller."""
        self.folders: list[Path] = []
        """Folders with the trajectories of each controller."""
        self._drawn: dict[str, Any] = {}
        if self.writes:
            try:
                ParquetCourse(out / "course", scenario, seeds)  # it checks for pyarrow and writes nothing yet
            except ValueError as error:
                raise ValueError(f"{error}, or add --course none") from None
        if self.in_parts:
            scenario.member(seeds)  # raises ValueError for episodes on several random feeders
            where = f"trajectories are written to {out / 'course'}" if self.writes else "trajectories are not written"
            say(
                console,
                f"{len(seeds)} x {scenario.horizon:,} steps need {size / 2**20:,.0f} MiB per controller (limit "
                f"{WHOLE_COURSE_BYTES // 2**20} MiB): metrics are computed while streaming, and {where}",
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
                self._drawn[name] = run.series(0)
                for sink in sinks:
                    sink.add([run.series(i) for i in range(len(self.seeds))], 0)
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
    """Draw one episode under several controllers as figure.png in a folder, and return the path."""
    runs = Runs(scenario, [seed], "none", out, console)
    for name, controller in controllers.items():
        runs.add(name, controller, lambda: None)
    runs.draw(out / "figure.png")
    return out / "figure.png"
