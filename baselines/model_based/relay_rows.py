"""Rows of the linear program of an episode that make regulators change their taps at given steps, and at no other.

A relay moves its tap after a number of steps out of band in a row, its delay. One step in band resets its clock. The
expected effect of this tap, or of one further up, on its volts counts at once. So a relay must be

- out of band, on the side of the tap, in the steps of its delay before a tap, and further out than the effect of taps
  that are made meanwhile if it is to go on;
- in band just before these steps and after the last tap of a sequence;
- between taps, in band once in the steps of its delay:

    low - z <= u + U_p (d - d0) + U_q (q - q0) <= high + z        u: relay volts around the trajectory

The slack z has a price, so it remains only if the rows cannot be met.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy import sparse

from dcgrid_env import ActingRelays
from dcgrid_env.baselines.model_based.voltage_rows import Linear

PRICE = 1.0
"""Share of J that a volt off the demand costs in one step; a tap is some 0.1 of J, and 0.75 V."""
_MARGIN_V = 0.01  # what the linear program may be off by, and more


class RelayRows:
    """The rows for an episode of ``horizon`` steps, with an unknown z for each step and relay."""

    def __init__(self, relays: ActingRelays, horizon: int) -> None:
        self.relays, self.horizon = relays, horizon
        self.count = horizon * len(relays.rows)
        """Unknowns z."""

    def limits(self, tap: np.ndarray, volts: Linear) -> list[tuple[dict[str, Any], np.ndarray]]:
        """Parts of the rows by their unknowns d, q and z, and what each row is at most.

        From the taps of all regulators at t = 0 and in each step, (1 + T, n_regulator), and the relay volts, (T, n).
        """
        low, high = (side.ravel() for side in self.demands(tap))
        at_zero, off = volts.at_zero.ravel(), sparse.csr_array(sparse.identity(self.count))
        limits = []
        for sign, most in ((1.0, high), (-1.0, -low)):
            limited = np.isfinite(most)
            by_d, by_q = volts.rows(limited, sign)
            room = most[limited] - sign * at_zero[limited] - _MARGIN_V
            limits.append(({"d": by_d, "q": by_q, "z": -off[limited]}, room))
        return limits

    def demands(self, tap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest volts that each relay is to measure after each step, (T, n), infinite where any will do.

        From the taps of all regulators, (1 + T, n_regulator).
        """
        relays, moves = self.relays, np.diff(tap, axis=0)
        expected = moves @ relays.settings.volts_per_tap[:, relays.rows]
        rest_low, rest_high = relays.rest_volts(tap[1:, relays.rows])  # a tap at its end goes no further
        low, high = np.full_like(rest_low, -np.inf), np.full_like(rest_high, np.inf)
        for n, (delay, further) in enumerate(zip(relays.steps, relays.further_steps, strict=True)):
            course = _Course(moves[:, relays.rows[n]], int(delay), int(further))
            for step, sign, goes_on in course.out_of_band():
                beyond = expected[step + 1, n] if goes_on else 0.0
                if sign > 0:
                    high[step, n] = relays.band_volts[0][n] - max(beyond, 0.0)
                else:
                    low[step, n] = relays.band_volts[1][n] - min(beyond, 0.0)
            in_band = course.in_band(np.isfinite(low[:, n]) | np.isfinite(high[:, n]))
            low[in_band, n], high[in_band, n] = rest_low[in_band, n], rest_high[in_band, n]
        return low, high


class _Course:
    """The taps of one regulator over an episode, and when its relay is to measure what."""

    def __init__(self, moves: np.ndarray, delay: int, further: int) -> None:
        self.moves, self.delay = moves, delay
        self.steps = np.flatnonzero(moves).tolist()
        later = list(zip(self.steps, self.steps[1:], strict=False))
        self.in_sequence = {after for before, after in later if after - before <= further}
        """Taps that follow another within its sequence."""
        self.begin = {step: step - delay for step in self.steps}
        self.begin |= {after: before for before, after in later if after in self.in_sequence}
        self.goes_on = {before for before, after in later if after in self.in_sequence}

    def out_of_band(self) -> Iterator[tuple[int, float, bool]]:
        """Steps after which it is out, 1 for too little or -1 for too much, and whether it stays out after taps."""
        for tap in self.steps:
            for step in range(max(self.begin[tap], 0), tap):
                yield step, float(np.sign(self.moves[tap])), step + 1 < tap or tap in self.goes_on

    def in_band(self, out: np.ndarray) -> list[int]:
        """Steps after which it is in band: around taps, and so often elsewhere that no clock runs out."""
        first = [tap for tap in self.steps if tap not in self.in_sequence]
        last = [tap for tap in self.steps if tap not in self.goes_on]
        around = {step for step in (*(self.begin[tap] - 1 for tap in first), *last) if step >= 0 and not out[step]}
        found, waited = [], 0
        for step in range(len(out)):
            waited += 1
            if out[step]:
                waited = 0
            elif step in around or waited == self.delay:
                found.append(step)
                waited = 0
        return found
