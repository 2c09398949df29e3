"""The figures of random feeders that published ones have too."""

from __future__ import annotations

import numpy as np

from dcgrid_env.grid.random_feeders.drawn import DrawnFeeder, draw_feeder
from dcgrid_env.grid.random_feeders.published import Figures
from dcgrid_env.grid.random_feeders.styles import STYLES


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
