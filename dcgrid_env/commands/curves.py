"""Draw learning curves out of training folders: a panel for each scenario, a line with its band for each algorithm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.commands.settings import make_folder


@dataclass(frozen=True)
class Curves:
    """What to draw."""

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of training runs (dcgrid train); those that differ in the seed alone are one line with its band."""
    out: Path = Path("results/curves.png")
    """The picture; folders are made."""


def main(cfg: Curves) -> None:
    """Read, draw, print. ValueError for a folder that holds no run, before anything is written."""
    from rich.console import Console

    from dcgrid_env.learning.curves import lines, read
    from dcgrid_env.learning.figures import curves_figure

    if not cfg.folders:
        raise ValueError("folders is empty; give the folder of at least one training run")
    found = lines([read(folder) for folder in cfg.folders])
    make_folder(cfg.out.parent)
    curves_figure(found).savefig(cfg.out, format="png", dpi=130)
    console = Console()
    for scenario, every in found.items():
        for line in every:
            console.print(
                f"{scenario}, {line.label}: {line.n_runs} run{'s' * (line.n_runs > 1)}, at the end "
                f"{line.mean_pct[-1]:.2f} % below the tuned droop ({line.low_pct[-1]:.2f} to {line.high_pct[-1]:.2f})",
                highlight=False,
            )
    console.print(f"wrote {cfg.out}", highlight=False)
