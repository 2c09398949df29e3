"""Find set points under which built-in controls take planned positions.

A relay below its band raises its tap until the relay volts are in band, and one above lowers it:

    tap after the step = clip(tap before, lowest tap with relay volts >= target - half_band,
                              highest tap with relay volts <= target + half_band)

The offset and half band of a bank apply to all its regulators, so their taps cannot be chosen independently. In each
step the plan tries a grid of offsets and half bands. It takes the pair whose resulting taps deviate least from the
planned ones, with a price on taps. Each pair is evaluated three times: with its band, with a wider and with a narrower
one, by ``MARGIN_V`` at either end. The result therefore also holds for slightly different relay volts.

The rule assumes that the controls finish within a step.
"""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np

from dcgrid_env import ActingRelays

MARGIN_V = 0.2
"""Error of the relay volts that a band should tolerate, V."""
OFFSETS, HALF_BANDS = 41, 8
"""Values of the offset and the half band that are tried for each bank."""
PER_MOVE = 0.8
"""Price of a tap, in taps off the plan in one step: a regulator rests while its bank cannot follow the plan."""
_SAME_TIME = 1e-9  # of a step


def relay_set_points(
    device: Any, relays: ActingRelays, first_tap: np.ndarray, taps: np.ndarray, relay_v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return offset and half band of each bank, V, (T, n_bank) each.

    Parameters
    ----------
    device
        The banks of regulators whose set points agents choose, ``RegulatorSetPoints``.
    relays
        Relays of all regulators that act.
    first_tap, taps
        Taps at t = 0 (n_regulator,) and planned taps of each step (T, n_regulator), of all regulators.
    relay_v
        Relay volts at the planned taps, (T, n), in the order of ``relays``.
    """
    settings, (offset, half_band) = relays.settings, device.channels
    chosen = np.empty((2, len(taps), device.count))
    for bank, rows in enumerate(map(list, device.members)):
        columns = np.searchsorted(relays.rows, rows)
        offsets = np.linspace(offset.lowest[bank], offset.highest[bank], OFFSETS)
        halves = np.linspace(half_band.lowest[bank], half_band.highest[bank], HALF_BANDS)
        offset_v, half_v = (values.ravel() for values in np.meshgrid(offsets, halves))
        target_v = settings.target_v[rows] + offset_v[:, None] - device.rest_offset_v[bank]
        wider_v = MARGIN_V * np.array([0.0, 1.0, -1.0])[:, None, None]
        low, high = target_v - half_v[:, None] - wider_v, target_v + half_v[:, None] + wider_v
        per_tap, ends = settings.volts_per_tap[rows, rows], (settings.lowest[rows], settings.highest[rows])
        tap = first_tap[rows]
        for step, (wanted, volts) in enumerate(zip(taps[:, rows], relay_v[:, columns], strict=True)):
            least, most = np.ceil((low - volts) / per_tap) + wanted, np.floor((high - volts) / per_tap) + wanted
            after = np.clip(np.minimum(np.maximum(tap, least), most), *ends)
            off = np.abs(after - wanted) + PER_MOVE * np.abs(after - tap)
            best = off.sum(axis=(0, 2)).argmin()
            chosen[:, step, bank] = offset_v[best], half_v[best]
            tap = after[0, best]
    return chosen[0], chosen[1]


def bank_set_points(device: Any, on: np.ndarray, delay_steps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return centre and half width of the thresholds of each capacitor bank, p.u., (T, n_bank) each.

    Parameters
    ----------
    device
        The capacitor banks whose thresholds agents choose, ``ThresholdSetPoints``.
    on
        Planned states of each step, (T, n_bank).
    delay_steps
        Delay of the control in steps; a switching begins so much earlier.
    """
    centre, half_width = device.channels
    lead = min(max(ceil(delay_steps - _SAME_TIME) - 1, 0), len(on))
    ahead = np.concatenate((on[lead:], np.repeat(on[-1:], lead, axis=0)))
    # The thresholds of a bank that moves are close together, those of one that stays far apart.
    before = np.concatenate((np.array(device.base)[None], ahead[:-1]))
    moves = ahead != before
    for step in range(1, lead + 1):
        moves[step:] |= (ahead != before)[:-step]
    return (
        np.where(ahead > 0.5, centre.highest, centre.lowest),
        np.where(moves, half_width.lowest, half_width.highest),
    )
