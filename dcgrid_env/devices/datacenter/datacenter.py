"""A data centre on the grid: work arrives, queues, is served as the clock allows, and draws power.

    a       = max(p_ref - p_idle, 0)                dynamic power asked for by newly arriving work
    d       = served(f, a + backlog / dt)           the clock law; never more than is there
    p       = min(p_ref, p_idle) + power(f, ...)    drawn from the grid
    backlog' = backlog + (a - d) dt                 kW s of nominal work

The model follows arXiv 2507.06416, section II, except that work cannot be served before it arrives. A law of two
classes has a, d and backlog for each class, with a in the proportion in which the work arrives. If p_ref may exceed the
rating for a moment (boost), the law uses max(p_rated - p_idle, a) as the site's dynamic power. Work that arrives above
the rating is then served at once at the top clock, while a backlog is worked off at the rating only. ``converter``
contains the reactive power of the converter.
"""

from __future__ import annotations

from typing import NamedTuple

from dcgrid_env.core.arrays import Array, namespace, sum_last
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.core.coverage import Coverage
from dcgrid_env.devices.datacenter.clock_law import Dvfs, LinearDvfs
from dcgrid_env.devices.datacenter.site_work import arriving, at_hand, idle_draw, left_over, serve_linearly, top_power
from dcgrid_env.devices.ratings import DataCenterParams

COVERED = Coverage({LinearDvfs: ""})
"""The clock law that ``serve_linearly`` covers."""


class DataCenterState(NamedTuple):
    """State of the data centres after a step, each (row, slot), or (row, slot, 2) by work class."""

    backlog_kws: Array
    """Queued work, kW s."""
    f_mhz: Array
    """Clock, MHz."""
    f_last_mhz: Array
    """Clock one step earlier, MHz."""
    arrived_kw: Array
    """Dynamic power for work that arrived in the interval, kW."""
    served_kw: Array
    """Dynamic power of work served in it, kW."""
    class_backlog_kws: Array
    """Backlog, work arrived and work served by work class, compute-bound first, each first come first served.

    With a clock law of one work class they equal the fields without class.
    """
    class_arrived_kw: Array
    class_served_kw: Array


class DataCenterStep(NamedTuple):
    """Result of the data centres over one interval, each of shape (..., n_dc)."""

    backlog_kws: Array
    """Work queued at the end, kW s."""
    arrived_kw: Array
    served_kw: Array
    p_kw: Array
    """Draw from the grid, kW."""
    class_backlog_kws: Array
    """The first three by work class, (..., n_dc, 2); with one work class, the very same arrays as above."""
    class_arrived_kw: Array
    class_served_kw: Array


def step(
    params: DataCenterParams,
    dvfs: Dvfs,
    class_backlog_kws: Array,
    p_ref_kw: Array,
    f_mhz: Array,
    dt_s: float,
    compute_share: Array | None = None,
    *,
    boost: bool = False,
) -> DataCenterStep:
    """Advance the data centres by one interval.

    Parameters
    ----------
    params, dvfs
        Ratings and clock law.
    class_backlog_kws
        Work queued at the beginning, kW s, (..., n_dc), or (..., n_dc, 2) under a law of two work classes.
    p_ref_kw
        Draw at the top clock with nothing queued, kW, (..., n_dc).
    f_mhz
        Clock, within its limits, MHz, (..., n_dc).
    dt_s
        Length of the interval, s.
    compute_share
        Compute-bound share of the arriving work, (..., n_dc), for a law of two work classes; None for one of one.
    boost
        Whether ``p_ref_kw`` may exceed the rating.
    """
    if type(dvfs) is LinearDvfs and _is_compiled(dvfs):
        ratings = params.p_idle_kw, params.p_dynamic_kw, params.f_max_mhz
        after = tuple(serve_linearly(*ratings, class_backlog_kws, p_ref_kw, f_mhz, dt_s, boost))
        return DataCenterStep(*after, *after[:3])
    arrived = arriving(params.p_idle_kw, p_ref_kw)
    if boost:
        params = params._replace(p_dynamic_kw=top_power(params.p_dynamic_kw, arrived))
    base = idle_draw(params.p_idle_kw, p_ref_kw)
    return serve_arrived(params, dvfs, class_backlog_kws, base, arrived, f_mhz, dt_s, compute_share)


@cached_on_owner
def _is_compiled(dvfs: LinearDvfs) -> bool:
    return COVERED.includes(dvfs)


def serve_arrived(
    params: DataCenterParams,
    dvfs: Dvfs,
    class_backlog_kws: Array,
    base_kw: Array,
    arrived_kw: Array,
    f_mhz: Array,
    dt_s: float,
    compute_share: Array | None = None,
    energy_share: Array | None = None,
) -> DataCenterStep:
    """Advance like ``step``, with the work separated from the other draw.

    Parameters
    ----------
    params, dvfs, class_backlog_kws, f_mhz, dt_s, compute_share
        Those of ``step``; ``params`` has the dynamic power that the law may give.
    base_kw
        Draw other than for work, kW, (..., n_dc).
    arrived_kw
        Work that arrives, as the dynamic power that it takes at the top clock, kW, (..., n_dc).
    energy_share
        Energy that work takes as a share of what it takes at the batch size of its trace, (..., n_dc); None for 1.
    """
    class_arrived, by_class = arrived_kw, energy_share
    if compute_share is not None:
        compute = arrived_kw * compute_share
        class_arrived = namespace(arrived_kw).concat((compute[..., None], (arrived_kw - compute)[..., None]), axis=-1)
        by_class = None if energy_share is None else energy_share[..., None]
    work_kw = at_hand(class_backlog_kws, class_arrived, dt_s)
    if by_class is None:
        class_served, dynamic = dvfs.serve(params, f_mhz, work_kw)
    else:
        class_served, dynamic = dvfs.serve(params, f_mhz, work_kw * by_class)
        class_served = class_served / by_class
    class_backlog = left_over(class_backlog_kws, class_arrived, class_served, dt_s)
    served, backlog = class_served, class_backlog
    if compute_share is not None:
        served, backlog = sum_last(class_served), sum_last(class_backlog)
    p = base_kw + dynamic
    return DataCenterStep(backlog, arrived_kw, served, p, class_backlog, class_arrived, class_served)
