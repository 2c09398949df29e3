"""Data centres behind a UPS: what ``DataCenters`` is beside, where it has a rule of ride-through.

What a site draws and serves is settled first, as without a UPS; then the rule says who is on the grid, and the battery
who is supplied. Work that is not supplied goes back into the queue, so none is lost.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, sum_last
from dcgrid_env.devices.datacenter.datacenter import DataCenterState
from dcgrid_env.devices.device import Channel, CostTerm, Field
from dcgrid_env.devices.ratings import DataCenterParams
from dcgrid_env.devices.ride_through import connection, connection_surrogate, ups_battery
from dcgrid_env.devices.ride_through.connection import ConnectionState, Supply
from dcgrid_env.devices.ride_through.rules import UpsRideThrough

HOLD_SHARE = 0.05
"""Part of the range of the channel ``return`` at its lower end that is to stay away, so that an agent can hit it."""


class UpsSiteState(NamedTuple):
    """State of data centres behind a UPS: that of ``DataCenterState``, and what the UPS adds."""

    backlog_kws: Array
    f_mhz: Array
    f_last_mhz: Array
    arrived_kw: Array
    served_kw: Array
    class_backlog_kws: Array
    class_arrived_kw: Array
    class_served_kw: Array
    ups: ConnectionState
    battery: ups_battery.BatteryState


def channels(rule: UpsRideThrough, slots: int) -> tuple[Channel, ...]:
    """The return, where the agent decides: share of the site's power that comes back in a second, 0 to stay."""
    if rule.release != "agent":
        return ()
    fastest = np.full(slots, 1.0 / rule.walk_in_s)
    return (Channel("return", "share/s", 0.0 * fastest, fastest, rest=fastest),)


def fields(rule: UpsRideThrough, slots: int) -> tuple[Field, ...]:
    """Where the UPS stands, its counters and its timers, as shares of what they run to."""
    one = np.ones(slots)
    return (
        Field("ups_share", "share of the power on the grid", 0.0, 1.0, one),
        Field("ups_locked", "1 where locked out", 0.0, 1.0, one),
        Field("ups_events", "share of those that lock it out", 0.0, 1.0, one * max(rule.lockout_events, 1)),
        Field("ups_returns", "share of those of a minute", 0.0, 1.0, one * max(rule.returns_per_minute, 1)),
        Field("ups_timer", "share of the time to a slow trip", 0.0, 1.0, one),
        Field("ups_wait", "share of the longest delay", 0.0, 1.0, one * max(rule.longest_wait_s(slots), 1e-9)),
        Field("ups_stored", "share of the battery's energy", 0.0, 1.0, one),
    )


def cost_terms(rule: UpsRideThrough, rated_kw: np.ndarray) -> tuple[CostTerm, ...]:
    """Trips, time away, and at the end what is missing in the batteries."""
    one, slots = np.ones_like(rated_kw), float(max(len(rated_kw), 1))
    of_all = float(rated_kw.sum()) or 1.0
    return (
        CostTerm("trips", "tripped", one, slots, 1.0, weight=rule.trip_weight),
        CostTerm("away", "away", one, slots, 1.0, weight=rule.away_weight),
        CostTerm("recharge", "missing_kws", rated_kw, of_all, rule.battery_s, at_end=True, weight=rule.missing_weight),
    )


def initial(rule: UpsRideThrough, params: DataCenterParams, site: DataCenterState, zero: Array) -> UpsSiteState:
    """Connected, with a full battery."""
    full = zero + params.p_rated_kw * rule.battery_s
    return UpsSiteState(*site, connection.initial(rule, zero), ups_battery.BatteryState(full, zero, zero, zero))


Serve = Callable[[DataCenterState, Array, Any], tuple[DataCenterState, Array]]
"""What sites do without a UPS: state before, clock and work to a state after and the draw, kW."""


def step(
    rule: UpsRideThrough,
    params: DataCenterParams,
    state: UpsSiteState,
    setpoints: tuple[Array, ...],
    supply: Supply,
    dt_s: float,
    serve: Serve,
) -> tuple[UpsSiteState, Array]:
    """Advance by one interval, see ``Device.step``; ``serve`` does what sites without a UPS do."""
    xp = namespace(state.backlog_kws)
    site, p_kw = serve(DataCenterState(*state[: len(DataCenterState._fields)]), setpoints[0], supply.given)
    pace: Any = connection.by_rule(rule, dt_s)
    if rule.release == "agent":
        rate = setpoints[1]
        hold, fastest = HOLD_SHARE / rule.walk_in_s, 1.0 / rule.walk_in_s
        pace = xp.where(rate >= hold, rate * dt_s, 0.0 * rate)
        if supply.widths is not None:
            pace = connection_surrogate.smoothed_pace(pace, rate, hold, fastest, dt_s, supply.widths)
    ups = connection.advance(rule, state.ups, supply, pace, dt_s)
    idle_kw = xp.minimum(supply.given.p_ref_kw, params.p_idle_kw)
    battery, grid_kw, works = ups_battery.step(
        rule, state.battery.stored_kws, ups.share, p_kw, idle_kw, site.served_kw, params.p_rated_kw, dt_s
    )
    ups = ups._replace(lost_kw=ups.tripped * state.ups.share * p_kw)
    return UpsSiteState(*_served(site, works, dt_s), ups, battery), grid_kw


def observe(rule: UpsRideThrough, params: DataCenterParams, state: UpsSiteState) -> tuple[Array, ...]:
    """Raw figures of ``fields``."""
    xp, ups = namespace(state.ups.share), state.ups
    recent = sum_last(xp.astype(ups.event_age_s < rule.lockout_window_s, ups.share.dtype))
    returns = sum_last(xp.astype(ups.return_age_s < 60.0, ups.share.dtype))
    full = params.p_rated_kw * rule.battery_s
    stored = state.battery.stored_kws / full if rule.battery_s > 0.0 else 0.0 * ups.share
    return ups.share, ups.locked, recent, returns, connection.timer_share(rule, ups), ups.wait_s, stored


def amount(rule: UpsRideThrough, name: str, params: DataCenterParams, state: UpsSiteState) -> Array | None:
    """What the terms of ``cost_terms`` charge; None for a name that is not theirs."""
    if name == "tripped":
        return state.ups.tripped
    if name == "away":
        return 1.0 - state.ups.share
    return params.p_rated_kw * rule.battery_s - state.battery.stored_kws if name == "missing_kws" else None


def totals(state: UpsSiteState) -> dict[str, Array]:
    """Trips and draw lost in the step, sites that are away or locked out, and the draw from batteries."""
    ups, xp = state.ups, namespace(state.ups.share)
    return {
        "ups_trips": sum_last(ups.tripped),
        "ups_lost_kw": sum_last(ups.lost_kw),
        "ups_away": sum_last(xp.astype(ups.share <= 0.0, ups.share.dtype)),
        "ups_locked": sum_last(ups.locked),
        "battery_kw": sum_last(state.battery.battery_kw),
    }


def metrics(rule: UpsRideThrough, rated_kw: np.ndarray, history: UpsSiteState, dt_s: float) -> dict[str, float]:
    """Figures of an episode, see ``engine.metrics``."""
    ups, battery = history.ups, history.battery
    away = ups.share[1:] < 1.0
    gone = np.flatnonzero(away.any(axis=1))
    lost_kw = ups.lost_kw[1:].sum(axis=1)
    return {
        "ups_trips": ups.tripped[1:].sum(),
        "ups_lost_kw": lost_kw.sum(),
        "ups_lost_step_kw": lost_kw.max(initial=0.0),
        "ups_away_s": (1.0 - ups.share[1:]).sum() * dt_s,
        "ups_locked_s": ups.locked[1:].sum() * dt_s,
        "ups_all_back_s": (gone[-1] - gone[0] + 1) * dt_s if len(gone) else 0.0,
        "battery_work_kws": battery.battery_work_kw[1:].sum() * dt_s,
        "battery_energy_kws": battery.battery_kw[1:].sum() * dt_s,
        "battery_missing_kws": np.maximum(rated_kw * rule.battery_s - battery.stored_kws[-1], 0.0).sum(),
    }


def _served(site: DataCenterState, works: Array, dt_s: float) -> DataCenterState:
    """The state with the work that is not supplied back in the queue."""
    by_class = works if site.class_served_kw.ndim == works.ndim else works[..., None]
    waiting = site.class_served_kw * (1.0 - by_class) * dt_s
    served, backlog = site.class_served_kw * by_class, site.class_backlog_kws + waiting
    one = by_class is works
    return site._replace(
        backlog_kws=backlog if one else sum_last(backlog),
        served_kw=served if one else sum_last(served),
        class_backlog_kws=backlog,
        class_served_kw=served,
    )
