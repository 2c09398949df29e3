"""The built-in controls of capacitor banks within a step: delays, and one switching after the other.

A threshold must be passed for the whole delay without a break. ``bank_delays`` and ``next_switchings`` lead from one
event to the next, as ``timed_taps`` does for regulators.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dcgrid_env.core.arrays import Array, namespace, take_last
from dcgrid_env.devices.capacitor_bank.bank_measurements import BankSettings, measured
from dcgrid_env.powerflow.unbalanced.three_phase_solution import ThreePhaseSolution

_SAME_TIME_S = 1e-6


class Thresholds(NamedTuple):
    """Thresholds that are in force in each environment, as ``BankSettings`` has them, (row, n_capacitor) each."""

    on_at: Array
    off_at: Array


class BankState(NamedTuple):
    """Capacitor banks of a feeder in the order of their table, (row, n_capacitor) each."""

    on: Array
    """1 for a bank that is on and 0 for one that is off."""
    v_pu: Array
    """Measured voltage, p.u.: by default the mean of its phases."""
    value: Array
    """What its thresholds apply to, as last measured; the voltage, if it goes by this."""
    beyond_s: Array
    """Time for which a threshold has been passed, s."""
    since_s: Array
    """Time since it was last switched, or since t = 0, s."""
    switched: Array
    """1 where it was switched in the last step, else 0."""
    switchings: Array
    """Switchings since t = 0."""


def measured_banks(settings: BankSettings, solution: ThreePhaseSolution, state: BankState) -> BankState:
    """The state with what each bank measures of a ``ThreePhaseSolution``."""
    if not state.on.shape[-1]:
        return state
    v_pu, value = measured(settings, solution, state.on)
    return state._replace(v_pu=v_pu, value=value)


def initial_banks(on: Array) -> BankState:
    """The state at t = 0 of banks that are on or off, (row, n_capacitor), before anything is measured."""
    zero = 0.0 * on
    return BankState(on, zero + 1.0, zero, zero, zero, zero, zero)


def bank_delays(
    settings: BankSettings,
    state: BankState,
    controlled: Array | None = None,
    thresholds: Thresholds | None = None,
) -> Array:
    """Time until each bank switches if its measurements stay, s, (row, n_capacitor); infinite within the thresholds.

    ``thresholds`` replace those of the settings.
    """
    xp, zero, is_on = namespace(state.on), 0.0 * state.on, state.on > 0.5
    limits = settings if thresholds is None else thresholds
    value, on_at, off_at = (settings.is_low * x for x in (state.value, limits.on_at, limits.off_at))
    turns_on = (value < on_at) | (state.v_pu < settings.low_pu)
    turns_off = (value > off_at) | (state.v_pu > settings.high_pu)
    itself = xp.arange(state.on.shape[-1], device=state.on.device)
    may_turn_on = (settings.before == itself) | (take_last(state.on, settings.before) > 0.5)
    may_turn_off = (settings.behind == itself) | (take_last(state.on, settings.behind) < 0.5)
    beyond = (turns_on & may_turn_on & ~is_on) | (turns_off & may_turn_off & is_on)
    beyond = beyond if controlled is None else beyond & (controlled > 0.0)
    to_on_s = settings.delay_on_s - state.beyond_s
    after_off_s = settings.dead_time_s + settings.delay_on_s - state.since_s
    to_on_s = xp.where((state.switchings > 0.0) & (after_off_s > to_on_s), after_off_s, to_on_s)
    left = xp.where(is_on, settings.delay_off_s - state.beyond_s, to_on_s)
    return xp.where(beyond, xp.where(left > 0.0, left, zero), zero + math.inf)


def next_switchings(state: BankState, delay_s: Array, passed_s: Array, acts: Array) -> BankState:
    """Let time pass until the next event, and switch the banks whose delay ends then.

    Parameters
    ----------
    state
        The banks, with what they measure now.
    delay_s
        Their delays by ``bank_delays``, s, (row, n_capacitor).
    passed_s
        Time until the event, s, (row, 1).
    acts
        Whether the event is before the end of the step, bool, (row, 1). Otherwise nothing is switched.
    """
    xp, zero = namespace(state.on), 0.0 * state.on
    due = acts & (delay_s <= passed_s + _SAME_TIME_S)
    switched = xp.where(due, zero + 1.0, zero)
    return state._replace(
        on=xp.where(due, 1.0 - state.on, state.on),
        beyond_s=xp.where(due | (delay_s == math.inf), zero, state.beyond_s + passed_s),
        since_s=xp.where(due, zero, state.since_s + passed_s),
        switched=state.switched + switched,
        switchings=state.switchings + switched,
    )
