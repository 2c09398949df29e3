"""The command ``dcgrid curves``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.settings import check_folder
from dcgrid_env.core.commands.terminal import plain_console, say

if TYPE_CHECKING:
    from dcgrid_env.agents.training.curves import Line


@dataclass(frozen=True)
class Curves(Command):
    """Draw learning curves of training runs.

    The figure has one panel per scenario and one line per algorithm, with a band over its seeds.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of training runs (dcgrid train). Runs that differ only in the seed share a line."""
    x: Literal["seconds", "steps"] = "seconds"
    """Horizontal axis: training time in seconds, or environment steps."""
    out: Path = Path("results/curves.png")
    """Image file. Its folder is created if missing."""

    def run(self) -> None:
        """Read, draw and print; raise ValueError before writing if a folder is not a training run."""
        from dcgrid_env.agents.training.curves import curves_figure, lines, read
        from dcgrid_env.core.files import write_figure

        if not self.folders:
            raise ValueError("folders: must name at least one folder of a training run, got none")
        by_scenario = lines([read(folder, self.x) for folder in self.folders])
        check_folder(self.out.parent)
        write_figure(self.out, curves_figure(by_scenario, self.x), dpi=130)
        console = plain_console()
        for scenario, every in by_scenario.items():
            for line in every:
                say(console, f"{scenario}, {line.label}: {ending(line)}")
        say(console, f"wrote {self.out}")


def ending(line: Line) -> str:
    """Return the final cost of a line's runs, relative to the tuned droop's cost."""
    mean, low, high = (_against(course[-1]) for course in (line.mean_pct, line.low_pct, line.high_pct))
    if line.n_runs == 1:
        return f"1 run, final J {mean} the tuned droop's"
    return f"{line.n_runs} runs, final J {mean} the tuned droop's on average (best {high}, worst {low})"


def _against(gain_pct: float) -> str:
    shown = round(float(gain_pct), 2)
    return f"{abs(shown):.2f} % {'below' if shown >= 0.0 else 'above'}"
