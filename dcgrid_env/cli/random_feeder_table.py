"""The command ``dcgrid dev random-feeders``."""

from __future__ import annotations

from dataclasses import dataclass

from dcgrid_env.cli.command import Command

LABELS = {
    "departures": ("departures from the substation", 0),
    "ends": ("share of buses where it ends", 2),
    "branchings": ("share of buses where it branches", 2),
    "mean_hops": ("hops to a bus, mean", 1),
    "trunk": ("hops to the farthest bus / sqrt(buses)", 2),
    "length_m": ("median length of a branch, m", 0),
    "r_by_x": ("median r/x", 2),
    "loaded": ("share of buses with a load", 2),
    "mean_kw": ("mean load of these, kW", 0),
    "load_cv": ("its standard deviation / mean", 2),
    "power_factor": ("median power factor", 2),
    "drop_pu": ("drop to the lowest bus at peak, p.u.", 3),
}
"""What each figure is called, and its decimals."""


@dataclass(frozen=True)
class RandomFeederTable(Command):
    """Compare random feeders with published ones.

    Prints the tables of docs/random-feeders.md.
    """

    draws: int = 200
    """Feeders of each style: seeds 0, 1, .."""
    n_bus: int = 100
    """Buses of each."""

    def run(self) -> None:
        """Print a table for each style. ValueError for a setting that cannot be."""
        import numpy as np

        from dcgrid_env.grid.random_feeders.published import PUBLISHED
        from dcgrid_env.grid.random_feeders.statistics import drawn_figures

        if self.draws < 1 or self.n_bus < 10:
            raise ValueError(f"draws is {self.draws} and n_bus {self.n_bus}; give at least 1 and at least 10")
        for style, published in PUBLISHED.items():
            generated = drawn_figures(style, self.n_bus, self.draws)
            print(f"{style}: {', '.join(f'{net.name} ({net.n_bus} buses)' for net in published)}\n")
            print("| | published | random, median (5 to 95 %) |\n|---|---|---|")
            for name, (label, decimals) in LABELS.items():
                known = [value for net in published if not np.isnan(value := float(getattr(net, name)))]
                low, high = min(known), max(known)
                said = f"{low:.{decimals}f} .. {high:.{decimals}f}" if len(known) > 1 else f"{low:.{decimals}f}"
                own = np.quantile([getattr(feeder, name) for feeder in generated], [0.5, 0.05, 0.95])
                middle, least, most = (f"{value:.{decimals}f}" for value in own)
                print(f"| {label} | {said} | {middle} ({least} to {most}) |")
            print()
