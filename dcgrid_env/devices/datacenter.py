"""A data centre on the grid: work arrives, queues, is served as the clock allows, and draws power.

    a       = max(p_ref - p_idle, 0)                dynamic power asked for by newly arriving work
    d       = served(f, a + backlog / dt)           the clock law; never more than is there
    p       = min(p_ref, p_idle) + power(f, ...)    drawn from the grid
    backlog' = backlog + (a - d) dt                 kW s of nominal work

After arXiv 2507.06416, section II, with work that cannot be served before it arrives. The converter's reactive side is
in ``converter``.
"""

from __future__ import annotations

from typing import NamedTuple

from dcgrid_env.arrays import Array, namespace, positive_part
from dcgrid_env.devices.dvfs import Dvfs
from dcgrid_env.devices.params import DataCenterParams


class DataCenterStep(NamedTuple):
    """What the data centres did over one interval, each of shape (..., n_dc)."""

    backlog_kws: Array
    """Work queued at the end, kW s."""
    arrived_kw: Array
    served_kw: Array
    p_kw: Array
    """Draw from the grid, kW."""


def step(
    params: DataCenterParams, dvfs: Dvfs, backlog_kws: Array, p_ref_kw: Array, f_mhz: Array, dt_s: float
) -> DataCenterStep:
    """Advance the data centres by one interval; arrays of shape (..., n_dc), ``f_mhz`` already within its limits."""
    arrived = positive_part(p_ref_kw - params.p_idle_kw)
    served, dynamic = dvfs.serve(params, f_mhz, arrived + backlog_kws / dt_s)
    return DataCenterStep(
        # The positive part takes off no more than the rounding of a queue that has just run empty.
        backlog_kws=positive_part(backlog_kws + (arrived - served) * dt_s),
        arrived_kw=arrived,
        served_kw=served,
        p_kw=namespace(p_ref_kw).minimum(p_ref_kw, params.p_idle_kw) + dynamic,
    )
