"""Built-in control of regulators from one tap to the next, on measured volts, within a step of any length.

The engine solves the power flow and passes the relay volts to ``next_taps``. It solves the power flow again under the
new taps. This goes on until no tap is due before the end of the step. The timer of a relay runs while it is out of
band; in band it returns to zero or counts down (``regulator_control``). After a tap the control looks again
``tap_delay_s`` later. Out of band it makes a further tap; in band the sequence ends and the next tap needs the whole
delay. The decisions have no derivative.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from dcgrid_env.core.arrays import Array, min_last, namespace
from dcgrid_env.core.formula import compiled_as
from dcgrid_env.devices.tap_changer.regulator_state import SAME_TIME_S, RegulatorState
from dcgrid_env.devices.tap_changer.relay import RelayBand, RelaySettings, direction


class NextTaps(NamedTuple):
    """Regulators after the time to the next event, which is a tap, a switching or the end of the step."""

    state: RegulatorState
    """With the volts measured before the event."""
    passed_s: Array
    """Time passed, s, (row, 1)."""


def next_taps(
    settings: RelaySettings,
    state: RegulatorState,
    band: RelayBand,
    left_s: Array,
    due_s: Array,
    integrating: bool,
    controlled: Array | None = None,
) -> NextTaps:
    """Let time pass until the next event, and make the taps that are due then.

    Parameters
    ----------
    settings, state
        Arrays of one kind; ``state.relay_v`` are the volts of now.
    band
        Targets and half bands in force, which replace those of the settings.
    left_s
        Time left of the step, s, (row, 1). Nothing happens in a row where it is 0, and taps due at its end are left to
        the next step, whose loads they meet.
    due_s
        Time until other equipment acts, s, (row, 1), infinite where none does.
    integrating
        Whether timers count down in band.
    controlled
        1 for a regulator whose control acts and 0 for one that stays, (n_regulator,); None where all act.
    """
    if not state.tap.shape[-1]:
        return NextTaps(state, namespace(left_s).where(due_s < left_s - SAME_TIME_S, due_s, left_s))
    *fields, passed = _next_taps(settings, state, band, left_s, due_s, integrating, controlled)
    return NextTaps(RegulatorState(*fields), passed[..., :1])


@compiled_as("dcgrid_env.devices.tap_changer.tap_kernels:next_taps", like="state")
def _next_taps(
    settings: RelaySettings,
    state: RegulatorState,
    band: RelayBand,
    left_s: Array,
    due_s: Array,
    integrating: bool,
    controlled: Array | None,
) -> tuple[Array, ...]:
    """The fields of the state after the event, and the time passed in each column, see ``next_taps``."""
    xp, zero = namespace(state.tap), 0.0 * state.tap
    wanted = direction(settings._replace(**band._asdict()), state.relay_v, state.tap)
    wanted = wanted if controlled is None else wanted * controlled
    out, sequence = wanted != 0.0, state.in_sequence != 0.0
    counts = out | sequence
    waited = state.out_of_band_s if integrating else xp.where(counts, state.out_of_band_s, zero)
    left_to_wait = xp.where(sequence, settings.tap_delay_s + zero, settings.delay_s + zero) - waited
    due_in = xp.where(counts, xp.where(left_to_wait > 0.0, left_to_wait, zero), zero + math.inf)
    first = min_last(due_in)
    soonest = xp.where(first < due_s, first, due_s)
    acts = soonest < left_s - SAME_TIME_S
    passed = xp.where(acts, soonest, left_s)
    counted_down = xp.where(waited > passed, waited - passed, zero)
    waited = xp.where(counts, waited + passed, counted_down)
    over = acts & (due_in <= soonest + SAME_TIME_S)
    turn = xp.where(over, wanted, zero)
    moved = xp.abs(turn)
    fields = (
        state.tap + turn,
        state.relay_v,
        xp.where(over, zero, waited),
        xp.where(over, moved, state.in_sequence),
        xp.where(moved > 0.0, zero, state.since_s + passed),
        state.moved + moved,
        state.moves + moved,
    )
    return *fields, passed + zero
