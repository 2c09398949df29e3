"""Formulas of the work of a data centre, which the environment and controllers share.

Work is measured as the dynamic power that serves it within an interval at the top clock.
"""

from __future__ import annotations

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.formula import PerSlot, formula, least, most, positive


@formula
def arriving(p_idle_kw: PerSlot, p_ref_kw: Array) -> Array:
    """Work that arrives over an interval with a draw of ``p_ref_kw`` at the top clock, kW."""
    return positive(p_ref_kw - p_idle_kw)


@formula
def idle_draw(p_idle_kw: PerSlot, p_ref_kw: Array) -> Array:
    """Draw other than for work, kW."""
    return least(p_ref_kw, p_idle_kw)


@formula
def at_hand(backlog_kws: Array, arriving_kw: Array, dt_s: float) -> Array:
    """Work that arrives and work that waits, kW."""
    return arriving_kw + backlog_kws / dt_s


@formula
def top_power(p_dynamic_kw: PerSlot, arriving_kw: Array) -> Array:
    """Dynamic power at the top clock of a site that may exceed its rating for work that arrives, kW."""
    return most(p_dynamic_kw + 0.0 * arriving_kw, arriving_kw)


@formula
def left_over(backlog_kws: Array, arriving_kw: Array, served_kw: Array, dt_s: float) -> Array:
    """Work queued after an interval, kW s.

    The positive part takes off no more than the rounding of a queue that has just run empty.
    """
    return positive(backlog_kws + (arriving_kw - served_kw) * dt_s)


@formula
def clock_for(p_idle_kw: PerSlot, p_dynamic_kw: PerSlot, f_min_mhz: PerSlot, f_max_mhz: PerSlot, p_kw: Array) -> Array:
    """Clock at which a busy site draws ``p_kw``, within its limits, MHz."""
    return least(most((p_kw - p_idle_kw) / p_dynamic_kw * f_max_mhz, f_min_mhz), f_max_mhz)


@formula(like="p_ref_kw", views=("f_mhz",))
def serve_linearly(
    p_idle_kw: PerSlot,
    p_dynamic_kw: PerSlot,
    f_max_mhz: PerSlot,
    backlog_kws: Array,
    p_ref_kw: Array,
    f_mhz: Array,
    dt_s: float,
    boost: bool,
) -> tuple[Array, Array, Array, Array]:
    """Backlog, kW s, work arrived and served, and draw, kW, under the linear clock law (``datacenter.step``)."""
    arrived = arriving(p_idle_kw, p_ref_kw)
    top_kw = top_power(p_dynamic_kw, arrived) if boost else p_dynamic_kw + 0.0 * arrived
    served = least(top_kw * (f_mhz / f_max_mhz), at_hand(backlog_kws, arrived, dt_s))
    return left_over(backlog_kws, arrived, served, dt_s), arrived, served, idle_draw(p_idle_kw, p_ref_kw) + served
