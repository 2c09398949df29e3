"""Bus 13 with a data centre and inverters only: whether it leaves the band, and what brings it there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dcgrid_env import Scenario, sensitivity
from dcgrid_env.apps.reproduction.levers import settled
from dcgrid_env.apps.reproduction.paper import PUBLISHED_BUSES
from dcgrid_env.apps.reproduction.study_runs import INVERTERS, Runs, nodes_of

BUS = PUBLISHED_BUSES[0]
OWN_KW = 280.0
"""Rating of a site, kW."""
LARGEST_KW = 20_000.0
"""Where the search for the rating that leaves the band ends."""


def bus_thirteen(runs: Runs) -> dict[str, Any]:
    """Runs with inverters only, and the drop at bus 13 taken apart at base load, every site at its rating.

    Figures that are not results of the runs are means over the bus's phases.
    """
    five, one_site = runs.setting.published(5), runs.setting.pinned((BUS,))
    low = runs.setting.with_head_at_1pu(5)
    own_load, others = {BUS: OWN_KW}, dict.fromkeys(runs.setting.sites[1:5], OWN_KW)
    nodes = nodes_of(five, BUS)
    r, x = (float(m[np.ix_(nodes, nodes)].mean()) for m in sensitivity(five.feeder))
    loads, with_own, with_all = (float(settled(five, p)[nodes].mean()) for p in ({}, own_load, own_load | others))
    base_at_1pu = float(settled(low)[nodes].mean())
    return {
        "bus": BUS,
        "r_pu_per_mw": r,
        "x_pu_per_mvar": x,
        "base_pu": loads,
        "drop_own_pu": loads - with_own,
        "drop_neighbours_pu": with_own - with_all,
        "leaves_band_kw": _leaves_band_kw(five, lambda kw: {BUS: kw} | others),
        "leaves_band_alone_kw": _leaves_band_kw(five, lambda kw: {BUS: kw}),
        **_run(runs, one_site, "alone"),
        **_run(runs, five, "five"),
        **_run(runs, low, "five_at_1pu"),
        "base_at_1pu": base_at_1pu,
        "base_at_1pu_squared": base_at_1pu**2,
    }


def _run(runs: Runs, scenario: Scenario, name: str) -> dict[str, float]:
    run = runs.run(scenario, INVERTERS)
    return {
        f"{name}_min_pu": float(run.each("first_site_min_pu").min()),
        f"{name}_outside_pct": run.mean("first_site_outside_pct"),
    }


def _leaves_band_kw(scenario: Scenario, load_kw: Callable[[float], Mapping[int, float]]) -> float | None:
    """Draw at bus 13 from which its lowest voltage is below the band at base load, kW, to 1 kW; None if it never is."""
    nodes, edge = nodes_of(scenario, BUS), 1.0 - scenario.cost.band_pu

    def below(kw: float) -> bool:
        v = settled(scenario, load_kw(kw))[nodes].min()
        return not v >= edge  # a load without a solution is beyond it too

    low, high = 0.0, LARGEST_KW
    if not below(high):
        return None
    while high - low > 1.0:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if below(middle) else (middle, high)
    return high
