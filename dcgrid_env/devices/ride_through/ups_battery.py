"""The battery of a UPS: it supplies a site that is off the grid, and is recharged after the site reconnects.

    b  = min(away p, E / dt)                             from the battery, away = 1 - share on the grid
    w  = (share p + b) / p                               share of the work that is done; what is not waits
    c  = min(c_max, (E_full - E) / (eta dt), p_rated - p)     drawn to recharge, once the site is back with all
    E' = E - b dt + eta c dt

If the rule lets work wait on battery, b supplies only the idle draw, and w is the share on the grid.
"""

from __future__ import annotations

from typing import NamedTuple

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.formula import PerSlot, choose, formula, least, positive
from dcgrid_env.devices.ride_through.rules import UpsRideThrough


class BatteryState(NamedTuple):
    """State of the batteries after a step, (row, slot) each."""

    stored_kws: Array
    """Energy stored, kW s."""
    battery_kw: Array
    """Draw from the battery over the step, kW."""
    recharge_kw: Array
    """Draw from the grid to recharge over the step, kW."""
    battery_work_kw: Array
    """Work served on battery over the step, kW."""


def step(
    rule: UpsRideThrough,
    stored_kws: Array,
    share: Array,
    p_kw: Array,
    p_idle_kw: Array,
    served_kw: Array,
    p_rated_kw: Array,
    dt_s: float,
) -> tuple[BatteryState, Array, Array]:
    """Supply a site from grid and battery over an interval.

    Parameters
    ----------
    rule, stored_kws
        The rule, and the energy stored at the beginning, kW s.
    share
        Share of the site's power that is on the grid, (row, slot).
    p_kw, p_idle_kw, served_kw
        What the site would draw, of that its idle draw, and the work that it would serve, kW, (row, slot).
    p_rated_kw
        Ratings, (slot,).
    dt_s
        Length of the interval, s.

    Returns
    -------
    state, grid_kw, works
        State at the end; draw from the grid, kW; share of the site's work that is done, 0 .. 1.
    """
    figures = *map(float, (rule.battery_s, rule.recharge_share, rule.charge_efficiency)), rule.on_battery == "serves"
    *state, grid_kw, works = _supplied(stored_kws, share, p_kw, p_idle_kw, served_kw, p_rated_kw, *figures, dt_s)
    return BatteryState(*state), grid_kw, works


@formula(like="p_kw")
def _supplied(
    stored_kws: Array,
    share: Array,
    p_kw: Array,
    p_idle_kw: Array,
    served_kw: Array,
    p_rated_kw: PerSlot,
    battery_s: float,
    recharge_share: float,
    efficiency: float,
    serves: bool,
    dt_s: float,
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """The fields of ``BatteryState``, the draw from the grid, kW, and the share of the work that is done."""
    full = p_rated_kw * battery_s
    wanted = (1.0 - share) * (p_kw if serves else p_idle_kw)
    battery_kw = least(wanted, stored_kws / dt_s)
    works = share
    if serves:
        some = p_kw > 0.0
        works = choose(some, (share * p_kw + battery_kw) / choose(some, p_kw, 1.0), 1.0)
    fastest = least(p_rated_kw * recharge_share + 0.0 * p_kw, positive(full - stored_kws) / (efficiency * dt_s))
    recharge = choose(share >= 1.0, least(fastest, positive(p_rated_kw - p_kw)), 0.0 * p_kw)
    after = least(positive(stored_kws - battery_kw * dt_s) + efficiency * dt_s * recharge, full + 0.0 * p_kw)
    works = choose(works > 1.0, 1.0, works)  # beyond 1 by rounding
    return after, battery_kw, recharge, (works - share) * served_kw, share * p_kw + recharge, works


def without_grid(rule: UpsRideThrough, state: BatteryState, available: Array, dt_s: float) -> BatteryState:
    """The state where a fault has taken the site from the grid, ``available`` 0: nothing has been recharged."""
    undone_kw = state.recharge_kw * (1.0 - available)
    return state._replace(
        stored_kws=state.stored_kws - rule.charge_efficiency * dt_s * undone_kw,
        recharge_kw=state.recharge_kw - undone_kw,
    )
