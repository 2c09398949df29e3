"""Maps of a feeder with the capacity of its buses."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from dcgrid_env.apps.hosting.hosting import Capacities
from dcgrid_env.rendering import capacity_figure


def capacity_maps(capacities: Capacities) -> Figure:
    """Draw one map per controller, all with the same colour scale."""
    feeder = capacities.study.scenario.feeder
    maps = {}
    for name in capacities.controllers:
        mw = np.full(feeder.n_bus, np.nan)
        mw[[feeder.index(bus) for bus in capacities.buses]] = [c.capacity_mw for c in capacities.by_controller[name]]
        maps[name] = mw
    limits = f"{capacities.study.v_min_pu:g} to {capacities.study.v_max_pu:g} p.u."
    return capacity_figure(feeder, maps, f"{feeder.name}: largest data centre at a bus within {limits}")
