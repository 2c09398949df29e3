"""The command ``dcgrid curves``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.settings import check_folder
from dcgrid_env.cli.terminal import plain_console, say

if TYPE_CHECKING:
    from dcgrid_env.agents.training.curves import Line


@dataclass(frozen=True)
class Curves(Command):
    """Draw learning curves of training runs.

    Draws a panel for each scenario, and a line with its band for each algorithm.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of training runs (dcgrid train); those that differ in the seed alone are one line with its band."""
    x: Literal["seconds", "steps"] = "seconds"
    """What they run along: training time, or steps of environments."""
    out: Path = Path("results/curves.png")
    """The picture; folders are made."""

    def run(self) -> None:
        """Read, draw, print. ValueError for a folder that holds no run, before anything is written."""
        from dcgrid_env.agents.training.curves import curves_figure, lines, read
        from dcgrid_env.core.files import write_figure

        if not self.folders:
            raise ValueError("folders is empty; give the folder of at least one training run")
        by_scenario = lines([read(folder, self.x) for folder in self.folders])
        check_folder(self.out.parent)
        write_figure(self.out, curves_figure(by_scenario, self.x), dpi=130)
        console = plain_console()
        for scenario, every in by_scenario.items():
            for line in every:
                say(console, f"{scenario}, {line.label}: {ending(line)}")
        say(console, f"wrote {self.out}")


def ending(line: Line) -> str:
    """Where the runs of a line end: how far below the tuned droop's cost, or above it."""
    mean, low, high = (_against(course[-1]) for course in (line.mean_pct, line.low_pct, line.high_pct))
    if line.n_runs == 1:
        return f"1 run, J at the end {mean} the tuned droop's"
    return f"{line.n_runs} runs, J at the end {mean} the tuned droop's on average (the best {high}, the worst {low})"


def _against(gain_pct: float) -> str:
    shown = round(float(gain_pct), 2)
    return f"{abs(shown):.2f} % {'below' if shown >= 0.0 else 'above'}"
