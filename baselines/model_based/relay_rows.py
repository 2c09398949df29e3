"""Rows of the linear program of an episode that make regulators change their taps at given steps, and at no other.

A relay moves its tap after so many steps out of band in a row, and one step back in band sets its clock to nothing. So
a relay is to be out of band in the steps of its delay before a tap, on that side; in band just before them and after
the last tap of a sequence; and between taps in band once in the steps of its delay:

    low - z <= u + U_p (d - d0) + U_q (q - q0) <= high + z        u: relay volts around the trajectory

with one side alone, or beyond the other limit, as the step demands. What it is off by, z, is priced so that it stays
only where the demand cannot be met.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from dcgrid_env import ActingRelays
from dcgrid_env.baselines.model_based.voltage_rows import Linear

PRICE = 1.0
"""Share of J that a volt off the demand costs in one step; a tap is some 0.1 of J, and 0.75 V."""
_MARGIN_V = 0.01  # what the linear program may be off by, and more
_FREE, _UP, _DOWN, _IN_BAND = 0, 1, -1, 2


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
        own = tap[:, self.relays.rows]
        demands = self.demands(own).ravel()
        low, high = (side.ravel() for side in self.relays.rest_volts(own[1:]))
        lowest, highest = (np.broadcast_to(side, own[1:].shape).ravel() for side in self.relays.band_volts)
        at_zero, off = volts.at_zero.ravel(), sparse.csr_array(sparse.identity(self.count))
        limits = []
        for sign, most, beyond, out in ((1.0, high, lowest, _UP), (-1.0, -low, -highest, _DOWN)):
            most = np.where(demands == out, beyond, most) - sign * at_zero
            # A tap at its end goes no further.
            limited = ((demands == _IN_BAND) | (demands == out)) & np.isfinite(most)
            by_d, by_q = volts.rows(limited, sign)
            limits.append(({"d": by_d, "q": by_q, "z": -off[limited]}, most[limited] - _MARGIN_V))
        return limits

    def demands(self, tap: np.ndarray) -> np.ndarray:
        """What each relay is to measure after each step, int, (T, n), for its taps (1 + T, n).

        1 for too little, so that the tap goes up, -1 for too much, 2 for volts in band, 0 for any.
        """
        demands = np.full((self.horizon, tap.shape[1]), _FREE)
        moves = np.diff(tap, axis=0)
        for relay, (delay, further) in enumerate(zip(self.relays.steps, self.relays.further_steps, strict=True)):
            demand, last = demands[:, relay], -self.horizon
            in_band = []
            for step in np.flatnonzero(moves[:, relay]):
                in_sequence = step - last <= further
                begin = last if in_sequence else step - delay
                demand[max(begin, 0) : step] = np.sign(moves[step, relay])
                if not in_sequence:
                    in_band += [begin - 1, last]
                last = step
            in_band.append(last)
            demand[[step for step in in_band if step >= 0 and demand[step] == _FREE]] = _IN_BAND
            _interrupt(demand, int(delay))
        return demands


def _interrupt(demand: np.ndarray, delay: int) -> None:
    """Demand volts in band so often that no clock runs out where nothing is demanded, in place."""
    waited = 0
    for step in range(len(demand)):
        waited = waited + 1 if demand[step] == _FREE else 0
        if waited == delay:
            demand[step], waited = _IN_BAND, 0
