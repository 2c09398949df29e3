"""Maps of a feeder with the capacity of its buses."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from dcgrid_env.apps.hosting.hosting import Capacities
from dcgrid_env.rendering import capacity_figure


def capacity_maps(found: Capacities) -> Figure:
    """Draw one map per controller, all with the same colour scale."""
    feeder = found.study.scenario.feeder
    maps = {}
    for name in found.controllers:
        mw = np.full(feeder.n_bus, np.nan)
        mw[[feeder.index(bus) for bus in found.buses]] = [c.capacity_mw for c in found.by_controller[name]]
        maps[name] = mw
    limits = f"{found.study.v_min_pu:g} to {found.study.v_max_pu:g} p.u."
    return capacity_figure(feeder, maps, f"{feeder.name}: largest data centre at a bus within {limits}")
