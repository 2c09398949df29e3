"""State of a feeder's regulators and their relays."""

from __future__ import annotations

from typing import NamedTuple

from dcgrid_env.core.arrays import Array

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
    """Time out of band less, if the timer integrates, later time in band, at least 0; or time since the last tap of a
    sequence, s."""
    in_sequence: Array
    """1 from a tap until its control has looked again and found the relay in band, else 0."""
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
