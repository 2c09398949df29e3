"""Random feeders compared with published ones, by figures that both have.

Figures of SimBench (S. Meinecke et al., Energies 13(12), 2020, 3290; the grids 1-*--0-no_sw), of CIGRE (task force
C6.04.02, Technical Brochure 575), of G. Kerber's networks (Kerber, TU Munich, 2011), and of Oberrhein were measured of
the nets of simbench 1.6 and pandapower 3. They are in their base case, with what their switches leave closed, at one
voltage (tests/docs/studies/learning/test_published_feeders.py). The other published feeders are bundled with dcgrid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dcgrid_env.core.commands.command import Command
from dcgrid_env.grid.random_feeders.drawn import DrawnFeeder, draw_feeder
from dcgrid_env.grid.random_feeders.styles import STYLES

NAN = float("nan")


class Figures(NamedTuple):
    """Figures of a feeder, or of a grid of several departures from one substation."""

    name: str
    n_bus: int
    departures: int
    """Branches that leave the substation."""
    ends: float
    """Share of buses without a further branch, the substation excluded."""
    branchings: float
    """Share of these buses with several further branches."""
    mean_hops: float
    """Branches between the substation and a bus, mean."""
    trunk: float
    """Branches to the farthest bus by the square root of the number of buses."""
    length_m: float
    """Median length of a branch, m; NaN where none are published."""
    r_by_x: float
    """Median of r/x over branches."""
    loaded: float
    """Share of buses with a load, the substation excluded."""
    mean_kw: float
    """Mean load of those, kW."""
    load_cv: float
    """Standard deviation of these loads by their mean."""
    power_factor: float
    """Median over loads."""
    drop_pu: float
    """Voltage of the substation less the lowest, p.u., in the base case."""


PUBLISHED: dict[str, tuple[Figures, ...]] = {
    "urban": (
        Figures("SimBench 1-MV-urban", 135, 11, 0.13, 0.01, 6.2, 1.55, 235, 1.16, 0.99, 371, 0.27, 0.93, 0.021),
        Figures("SimBench 1-MV-semiurb", 114, 9, 0.13, 0.04, 7.2, 2.06, 400, 3.36, 0.98, 282, 0.36, 0.93, 0.014),
    ),
    "rural": (
        Figures("SimBench 1-MV-rural", 94, 8, 0.13, 0.04, 7.3, 2.17, 600, 2.18, 0.98, 187, 0.65, 0.93, 0.011),
        Figures("Oberrhein, south", 69, 2, 0.16, 0.13, 15.0, 3.61, 404, 1.38, 0.90, 460, 0.34, 0.98, 0.039),
        Figures("Oberrhein, north", 108, 2, 0.19, 0.17, 16.4, 3.27, 371, 1.38, 0.80, 393, 0.36, 0.98, 0.046),
        Figures("CIGRE MV, subnetwork 1", 11, 1, 0.30, 0.20, 3.7, 1.81, 1035, 0.70, 0.90, 480, 0.39, 0.97, 0.069),
    ),
    "european-lv": (
        Figures("SimBench 1-LV-rural1", 14, 4, 0.31, 0.00, 2.5, 1.34, 25, 2.57, 1.00, 6, 0.72, 0.93, 0.006),
        Figures("SimBench 1-LV-rural2", 96, 4, 0.06, 0.02, 14.3, 3.78, 17, 2.57, 0.98, 2, 0.87, 0.93, 0.015),
        Figures("SimBench 1-LV-rural3", 128, 9, 0.15, 0.07, 9.7, 2.39, 11, 2.57, 0.93, 3, 0.62, 0.93, 0.015),
        Figures("SimBench 1-LV-semiurb4", 43, 3, 0.14, 0.07, 7.7, 2.59, 15, 2.57, 0.93, 6, 0.67, 0.93, 0.023),
        Figures("SimBench 1-LV-urban6", 58, 7, 0.19, 0.07, 5.6, 1.97, 17, 1.59, 0.93, 8, 0.52, 0.93, 0.020),
        Figures("Kerber Dorfnetz", 115, 6, 0.50, 0.45, 6.5, 1.59, 31, 5.07, 0.50, 6, 0.00, 1.00, 0.033),
        Figures("Kerber Vorstadtnetz", 293, 10, 0.50, 0.47, 10.1, 1.93, 11, 4.36, 0.50, 2, 0.00, 1.00, 0.016),
        Figures("CIGRE LV, residential", 18, 1, 0.29, 0.24, 5.6, 2.36, 35, 1.95, 0.29, 39, 0.40, 0.95, 0.064),
    ),
    "us-mv": (
        Figures("ieee33", 33, 1, 0.12, 0.09, 8.0, 2.96, NAN, 1.27, 1.00, 116, 0.79, 0.90, 0.087),
        Figures("das69", 69, 1, 0.12, 0.09, 11.4, 3.13, NAN, 1.96, 0.71, 79, 2.38, 0.81, 0.091),
        Figures("ieee123", 123, 1, 0.33, 0.28, 12.8, 2.07, 84, 0.99, 0.70, 41, 0.88, 0.89, 0.114),
        Figures("khodr141", 141, 1, 0.31, 0.26, 15.3, 2.61, NAN, 1.41, 0.60, 142, 0.96, 0.85, 0.072),
    ),
}
"""Published feeders by the style that they are an example of."""


def figures(name: str, drawn: DrawnFeeder) -> Figures:
    """The figures of a feeder as it was drawn."""
    tree, n_bus = drawn.tree, len(drawn.p_kw)
    leaving = np.bincount(tree.parent, minlength=n_bus)
    hops = tree.along(np.ones(n_bus - 1))
    load = drawn.p_kw[drawn.p_kw > 0]
    reactive = drawn.q_kvar[drawn.p_kw > 0]
    return Figures(
        name=name,
        n_bus=n_bus,
        departures=int(leaving[0]),
        ends=float((leaving[1:] == 0).mean()),
        branchings=float((leaving[1:] >= 2).mean()),
        mean_hops=float(hops.mean()),
        trunk=float(hops.max() / np.sqrt(n_bus)),
        length_m=float(1e3 * np.median(drawn.length_km)),
        r_by_x=float(np.median(drawn.r_ohm / drawn.x_ohm)),
        loaded=len(load) / (n_bus - 1),
        mean_kw=float(load.mean()),
        load_cv=float(load.std() / load.mean()),
        power_factor=float(np.median(load / np.hypot(load, reactive))),
        drop_pu=drawn.drop_pu,
    )


def drawn_figures(style: str, n_bus: int, draws: int) -> list[Figures]:
    """The figures of the feeders of the seeds 0, 1, .. of a style."""
    return [figures(f"{style} {seed}", draw_feeder(seed, n_bus, STYLES[style], None)) for seed in range(draws)]


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
"""Label and number of decimals of each figure."""


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
        """Print a table for each style. ValueError for an invalid setting."""
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
