"""Disconnection and reconnection of devices: exact and discrete, for a whole batch, on any kind of array.

In each interval, in this order:

1. Slow: an element of the curve counts how long the voltage of the intervals before has been beyond its threshold; a
   connected device whose element has counted its time leaves. So it leaves at most a step late.
2. Sags that begin in the interval, first to last: a device whose curve does not ride through one has an event.
3. An event disconnects for the whole interval, and enough of them within the window lock the device out.
4. A device without an event, not locked out, whose voltage has been in order for its delay, returns by a ramp.

A lock-out ends when its rule or its agent releases it. A derivative runs through the ramp's speed alone: whether a
device is connected is a step function, which has none but where a smooth surrogate is asked for
(``connection_surrogate``).
"""

from __future__ import annotations

from types import ModuleType
from typing import NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, as_like, namespace, sum_last
from dcgrid_env.core.formula import compiled_as
from dcgrid_env.devices.device import DeviceInput
from dcgrid_env.devices.ride_through import connection_surrogate
from dcgrid_env.devices.ride_through.rules import ALL_BACK, Figures, RideThrough

_MINUTE_S = 60.0


class Supply(NamedTuple):
    """Input of a device with a ride-through rule over an interval."""

    device_input: DeviceInput
    """Usual input of the device, see ``Device.input``."""
    v_lowest_pu: Array
    """Voltage of its lowest phase before the interval, p.u., (row, slot)."""
    v_highest_pu: Array
    """Voltage of its highest."""
    sags: Array | None
    """Sags by their beginning, (row, n_sag, 3); None if the scenario has no sags.

    The columns are: duration, s, 0 for a sag that does not begin in the interval; remaining share of the voltage; time
    from its beginning to the end of the interval, s.
    """
    widths: connection_surrogate.TripWidths | None = None
    """Widths of the surrogate that gives tensors a derivative of what trips and returns; None for no derivative."""
    available: Array | None = None
    """1 where a fault has left the device on the grid and 0 where not, (row, slot); None where all are."""


class ConnectionState(NamedTuple):
    """State of the connection after a step, (row, slot) unless a field states another shape."""

    share: Array
    """Share of the device's power that is on the grid, 0 away, 1 back."""
    timer_s: Array
    """Time for which the voltage has been beyond each threshold, s, (row, slot, n_element)."""
    wait_s: Array
    """Time since the last event, or since the voltage has been in order, s, cut at the longest that a rule asks for."""
    event_age_s: Array
    """Ages of the latest events, the latest first, s, (row, slot, lockout_events)."""
    return_age_s: Array
    """Ages of the latest returns, the same, (row, slot, returns_per_minute)."""
    locked: Array
    """1 where it is locked out, 0 elsewhere."""
    tripped: Array
    """1 where it left the grid in the step."""
    lost_kw: Array
    """Draw that was lost by disconnecting in the step, kW, an injection negative."""


def initial(rule: RideThrough, zero: Array) -> ConnectionState:
    """Connected, with nothing remembered; ``zero`` is 0, (row, slot)."""
    slots = zero.shape[-1]
    old = zero + rule.remembered_s
    return ConnectionState(
        share=zero + 1.0,
        timer_s=_repeated(zero, rule.elements(slots).count),
        wait_s=zero + rule.longest_wait_s(slots),
        event_age_s=_repeated(old, rule.lockout_events),
        return_age_s=_repeated(old, rule.returns_per_minute),
        locked=zero,
        tripped=zero,
        lost_kw=zero,
    )


def advance(
    rule: RideThrough, before: ConnectionState, supply: Supply, pace: Array | float, dt_s: float
) -> ConnectionState:
    """The connection over one interval.

    Parameters
    ----------
    rule, before
        The rule, and the state at the beginning.
    supply
        Voltage and sags.
    pace
        Share of the power that a device may resume in this interval, (row, slot) or one number; 0 for no change.
    dt_s
        Length of the interval, s.

    Returns
    -------
    state
        At the end, with ``lost_kw`` 0, which the device fills in.
    """
    figures = _figures(rule, before.share)
    volts = supply.v_lowest_pu, supply.v_highest_pu
    pace = pace + 0.0 * before.share if isinstance(pace, float) else pace
    return ConnectionState(*_advanced(before, *volts, supply.sags, pace, figures, supply.widths, dt_s))


@compiled_as(
    "dcgrid_env.devices.ride_through.connection_kernel:advance_rows",
    like="before",
    views=("v_lowest_pu", "v_highest_pu"),
)
def _advanced(
    before: ConnectionState,
    v_lowest_pu: Array,
    v_highest_pu: Array,
    sags: Array | None,
    pace: Array,
    figures: Figures,
    widths: connection_surrogate.TripWidths | None,
    dt_s: float,
) -> tuple[Array, ...]:
    """The fields of the state after an interval, with ``lost_kw`` 0."""
    xp = namespace(before.share)
    threshold, time_s, delay_s, release_s, n_under, longest_s, remembered_s, window_s = figures
    v = _measured(xp, v_lowest_pu, v_highest_pu, n_under, threshold.shape[-1] - n_under)
    beyond = v < threshold
    out_of_order = beyond.any(-1)
    timer_s = xp.where(beyond, before.timer_s + dt_s, 0.0 * before.timer_s)
    connected = before.share > 0.0
    event = slow = (beyond & (timer_s + 1e-3 * dt_s >= time_s)).any(-1) & connected

    soon = 1e-3 * dt_s
    may_go = (pace > 0.0) & ~out_of_order
    released = (before.locked > 0.0) & (before.wait_s + soon >= release_s) & may_go
    locked = (before.locked > 0.0) & ~released
    aged = before.event_age_s + dt_s
    age_s = xp.where((aged > remembered_s) | released[..., None], 0.0 * aged + remembered_s, aged)
    age_s = _with_new(xp, event, dt_s + 0.0 * before.wait_s, age_s)
    locked = locked | _is_full(event, age_s, window_s)
    since_s = xp.where(out_of_order, 0.0 * before.wait_s, before.wait_s + dt_s)
    since_s = xp.where(event, 0.0 * since_s + dt_s, since_s)
    for duration_s, retained, rest_s in _sags(sags):
        fell = ((v * retained[..., None] < threshold) & (timer_s + duration_s[..., None] > time_s)).any(-1)
        fell = fell & (duration_s > 0.0)
        age_s = _with_new(xp, fell, rest_s + 0.0 * since_s, age_s)
        locked = locked | _is_full(fell, age_s, window_s)
        since_s = xp.where(fell, rest_s + 0.0 * since_s, since_s)
        event = event | fell

    ready = ~event & (before.wait_s + soon >= xp.where(released, 0.0 * delay_s, delay_s)) & ~connected
    return_s = before.return_age_s + dt_s
    return_s = xp.where(return_s > remembered_s, 0.0 * return_s + remembered_s, return_s)
    if return_s.shape[-1]:
        ready = ready & (return_s[..., -1] >= _MINUTE_S)
    start = ready & ~locked & may_go
    grown = before.share + pace
    full = xp.where(grown > ALL_BACK, 0.0 * grown + 1.0, grown)
    share = xp.where((connected | start) & ~event, full, 0.0 * full)
    after = ConnectionState(
        share=share,
        timer_s=timer_s,
        wait_s=xp.where(since_s > longest_s, 0.0 * since_s + longest_s, since_s),
        event_age_s=age_s,
        return_age_s=_with_new(xp, start, 0.0 * before.wait_s, return_s),
        locked=xp.astype(locked, before.share.dtype),
        tripped=xp.astype(event & connected, before.share.dtype),
        lost_kw=0.0 * before.share,
    )
    if widths is None:
        return after
    is_requested = (before.locked <= 0.0) | (before.wait_s + soon >= release_s)
    may_return = ready & is_requested & ~out_of_order
    fell = event & ~slow
    return connection_surrogate.with_derivatives(
        before, after, v, threshold, time_s, fell, may_return, pace, dt_s, widths
    )


def by_rule(rule: RideThrough, dt_s: float) -> float:
    """Share of its power that a device takes back in an interval by a rule without an agent."""
    return min(1.0, dt_s / rule.walk_in_s) if rule.walk_in_s > 0.0 else 1.0


def counters(rule: RideThrough, state: ConnectionState) -> tuple[Array, Array, Array]:
    """Return what each device has counted, (row, slot) each.

    Returns
    -------
    events, returns, timer_share
        Events within the window of a lock-out; returns within a minute; the largest share of its time to a slow trip
        that an element has counted, 0 .. 1.
    """
    return _counted(state, _figures(rule, state.share))


@compiled_as("dcgrid_env.devices.ride_through.connection_kernel:counted", like="state")
def _counted(state: ConnectionState, figures: Figures) -> tuple[Array, Array, Array]:
    """See ``counters``."""
    xp, timer_s = namespace(state.share), state.timer_s
    shares = xp.where(timer_s > 0.0, timer_s / (figures.time_s + 1e-9), 0.0 * timer_s)
    largest = shares.max(-1, initial=0.0) if isinstance(shares, np.ndarray) else shares.amax(-1)
    limits = (state.event_age_s, figures.window_s), (state.return_age_s, _MINUTE_S)
    events, returns = (sum_last(xp.astype(ages_s < limit_s, ages_s.dtype)) for ages_s, limit_s in limits)
    return events, returns, xp.where(largest > 1.0, 0.0 * largest + 1.0, largest)


def _figures(rule: RideThrough, like: Array) -> Figures:
    """The figures of a rule as arrays of the kind, precision and device of ``like``, (row, slot)."""
    figures = rule.figures(like.shape[-1])
    if like.dtype == np.float64:
        return figures
    return figures._make(as_like(a, like) if isinstance(a, np.ndarray) else a for a in figures)


def _measured(xp: ModuleType, v_lowest_pu: Array, v_highest_pu: Array, n_under: int, n_over: int) -> Array:
    """What each element compares with its threshold, p.u., (row, slot, n_element)."""
    low = _repeated(v_lowest_pu, n_under)
    return low if not n_over else xp.concat((low, -_repeated(v_highest_pu, n_over)), axis=-1)


def _repeated(values: Array, times: int) -> Array:
    """Values with a further axis along which they repeat."""
    return namespace(values).broadcast_to(values[..., None], (*values.shape, times)) + 0.0


def _sags(sags: Array | None) -> Array:
    """Duration, share left and rest of each sag that begins in the interval in any row, (row, 1) each, in turn."""
    if sags is None:
        return
    for i in range(sags.shape[1]):
        if bool((sags[:, i, 0] > 0.0).any()):
            yield sags[:, i, 0:1], sags[:, i, 1:2], sags[:, i, 2:3]


def _with_new(xp: ModuleType, where: Array, age_s: Array, ages_s: Array) -> Array:
    """Ages with a new one in front, and the oldest gone, where there is one."""
    if not ages_s.shape[-1]:
        return ages_s
    return xp.where(where[..., None], xp.concat((age_s[..., None], ages_s[..., :-1]), axis=-1), ages_s)


def _is_full(event: Array, age_s: Array, window_s: float) -> Array:
    """Whether an event is the last of enough within the window."""
    return event & (age_s[..., -1] <= window_s) if age_s.shape[-1] else event & ~event
