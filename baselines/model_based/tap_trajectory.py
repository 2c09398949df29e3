"""The tap trajectory over an episode, and the relay volts in each step that make built-in controls follow it.

Relay volts are those at the end of a step, under the taps that it ends with. A tap is decided at the beginning of its
step, under the taps before it. All delays are whole steps here (``ActingRelays.steps``).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from dcgrid_env import ActingRelays
from dcgrid_env.baselines.model_based.voltage_rows import Linear

BELOW, IN_BAND, ABOVE, ANY = -1.0, 0.0, 1.0, np.nan
"""Where relay volts lie relative to the band; ``ANY`` where it makes no difference."""
MARGIN_V = 0.02
"""Distance that planned relay volts keep from the edges of the band: the linear program may be off by as much."""


class Demands(NamedTuple):
    """Lowest and highest relay volts at the end of each step, (T, R), infinite where any will do."""

    low: np.ndarray
    high: np.ndarray

    def limits(self, volts: Linear) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
        """Parts of a program's rows by their unknowns d, q and z, and what each row is at most.

        z is how far a relay is off its demand, an unknown of each step and relay.
        """
        off, at_zero = sparse.csr_array(sparse.identity(self.low.size)), volts.at_zero.ravel()
        for sign, most in ((1.0, self.high.ravel()), (-1.0, -self.low.ravel())):
            limited = np.isfinite(most)
            by_d, by_q = volts.rows(limited, sign)
            yield {"d": by_d, "q": by_q, "z": -off[limited]}, most[limited] - sign * at_zero[limited] - MARGIN_V


class TapTrajectory(NamedTuple):
    """Taps of R relays' regulators, and where their volts must lie for it."""

    tap: np.ndarray
    """At t = 0 and at the end of each step, (1 + T, R)."""
    side: np.ndarray
    """Where volts lie, (T, R): at the beginning of a step with a tap, else at its end."""
    due: np.ndarray
    """Whether the relay's delay is over at the beginning of the step, bool, (T, R)."""

    @classmethod
    def of_taps(cls, tap: np.ndarray) -> TapTrajectory:
        """The trajectory with these taps whose relays are not yet planned, (1 + T, R)."""
        shape = tap[1:].shape
        return cls(tap, np.full(shape, ANY), np.zeros(shape, bool))

    @property
    def moves(self) -> np.ndarray:
        """Tap of each step, -1, 0 or 1, (T, R)."""
        return np.diff(self.tap, axis=0)

    def demands(self, relays: ActingRelays, effect: np.ndarray) -> Demands:
        """Volts that the relays have to measure. The taps of each step change them by ``effect``, (T, R)."""
        moves = self.moves
        low, high = relays.band_volts
        rest_low, rest_high = relays.rest_volts(self.tap[1:])
        # A relay whose delay is over is in band before the taps of the step and after them.
        before = np.where(self.due, effect, 0.0)
        rest_low, rest_high = rest_low + np.maximum(before, 0.0), rest_high + np.minimum(before, 0.0)
        shift = np.where(moves != 0.0, effect, 0.0)
        in_band, below, above = (self.side == side for side in (IN_BAND, BELOW, ABOVE))
        return Demands(
            np.where(in_band, rest_low, np.where(above, high + shift, -np.inf)),
            np.where(in_band, rest_high, np.where(below, low + shift, np.inf)),
        )
