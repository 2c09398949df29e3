"""Built-in control of a regulator over time: a delay before the first tap, a shorter one between further taps.

The relay's timer runs while it is out of band and restarts at each tap. Back in band, timer and sequence are reset.
A step may be of any length. If several taps are due within it, the volts after each tap are predicted from the size of
the taps, also for regulators further down. This ends when all are in band or the time is used up. The next measurement
shows the actual effect of a tap. The decisions have no derivative.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dcgrid_env.core.arrays import Array, min_last, namespace
from dcgrid_env.core.twins import compiled_as
from dcgrid_env.devices.tap_changer.relay import RelaySettings, direction

MOST_EVENTS = 1000
"""Taps at different times within one step; a step that asks for more goes on with them in the next."""
SAME_TIME_S = 1e-6
"""Times that are less than this apart are one, s."""


class RegulatorState(NamedTuple):
    """Regulators of a feeder in the order of their table, (row, n_regulator) each."""

    tap: Array
    relay_v: Array
    """Relay volts, as last measured."""
    out_of_band_s: Array
    """Time out of band, or since the last tap of the sequence, s; 0 in band."""
    in_sequence: Array
    """1 once a tap has been made that did not bring the volts back in band, else 0."""
    since_s: Array
    """Time since the last tap, or since t = 0, s."""
    moved: Array
    """Taps made in the last step, in either direction."""
    moves: Array
    """Taps made since t = 0."""


def initial_regulators(tap: Array, relay_v: Array) -> RegulatorState:
    """The state at t = 0, at given taps and relay volts, (row, n_regulator) each."""
    zero = 0.0 * tap
    return RegulatorState(tap, relay_v, zero, zero, zero, zero, zero)


def control_taps(
    settings: RelaySettings, state: RegulatorState, dt_s: float, controlled: Array | None = None
) -> RegulatorState:
    """Advance the regulators by ``dt_s``, from the volts that their relays measure at its beginning.

    Parameters
    ----------
    settings, state
        Arrays of one kind.
    dt_s
        Length of the step, s.
    controlled
        1 for a regulator whose control acts and 0 for one that stays, (n_regulator,); None where all act.

    Returns
    -------
    RegulatorState
        With the volts as they are predicted under the new taps.
    """
    if not state.tap.shape[-1]:
        return state
    return RegulatorState(*_controlled(settings, state, float(dt_s), controlled))


@compiled_as("dcgrid_env.devices.tap_changer.tap_kernels:control_taps", like="state")
def _controlled(
    settings: RelaySettings, state: RegulatorState, dt_s: float, controlled: Array | None
) -> tuple[Array, ...]:
    """The fields of the state after the step, see ``control_taps``."""
    xp, tap, volts, since = namespace(state.tap), state.tap, state.relay_v, state.since_s
    zero = 0.0 * tap
    wanted = _wanted(settings, volts, tap, controlled)
    waited, sequence = (xp.where(wanted != 0.0, a, zero) for a in (state.out_of_band_s, state.in_sequence))
    left, moved = zero[..., :1] + dt_s, zero
    for _ in range(MOST_EVENTS):
        delay = xp.where(sequence != 0.0, settings.tap_delay_s, settings.delay_s)
        due_in = xp.where(wanted != 0.0, xp.where(delay > waited, delay - waited, zero), zero + math.inf)
        soonest = min_last(due_in)
        goes_on = soonest <= left + SAME_TIME_S
        if not bool(xp.any(goes_on)):
            break
        passed = xp.where(goes_on, xp.where(soonest < left, soonest, left), 0.0 * left)
        turn = xp.where(goes_on & (due_in <= soonest + SAME_TIME_S), wanted, zero)
        tap = tap + turn
        volts = volts + (turn[..., None] * settings.volts_per_tap).sum(-2)
        moved = moved + xp.abs(turn)
        since = xp.where(turn != 0.0, zero, since + passed)
        wanted = _wanted(settings, volts, tap, controlled)
        in_band = wanted == 0.0
        waited = xp.where((turn != 0.0) | in_band, zero, waited + passed)
        sequence = xp.where(in_band, zero, xp.where(turn != 0.0, zero + 1.0, sequence))
        left = left - passed
    waited = xp.where(wanted != 0.0, waited + left, zero)
    return tap, volts, waited, sequence, since + left, moved, state.moves + moved


def _wanted(settings: RelaySettings, relay_v: Array, tap: Array, controlled: Array | None) -> Array:
    turn = direction(settings, relay_v, tap)
    return turn if controlled is None else turn * controlled
