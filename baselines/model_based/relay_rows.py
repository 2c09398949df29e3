"""Rows of the linear program of an episode that keep regulators from changing their taps.

A relay moves its tap after so many steps out of band in a row, and one step back in band sets its clock to nothing. So
each relay is to be in band once in that many steps:

    low - z <= u + U_p (d - d0) + U_q (q - q0) <= high + z        u: relay volts around the trajectory

What it is beyond its band then, z, is priced so that it stays only where the band cannot be kept.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from dcgrid_env import ActingRelays

PRICE = 1.0
"""Share of J that a volt beyond the band costs in one step; a tap is some 0.1 of J, and 0.75 V."""
_MARGIN_V = 0.01  # what the linear program may be off by, and more


class RelayRows:
    """The rows for an episode of ``horizon`` steps."""

    def __init__(self, relays: ActingRelays, horizon: int) -> None:
        self.relays = relays
        step = np.arange(1, horizon + 1)[:, None]
        self.in_band = (step % relays.steps == 0).ravel()
        """Where in (horizon, n) the relay is to be in band, flattened."""
        self.count = int(self.in_band.sum())
        """Unknowns z."""

    def limits(self, tap: np.ndarray, at_zero: np.ndarray, by_p: np.ndarray, by_q: np.ndarray) -> list[tuple[Any, ...]]:
        """Parts for d, q and z of the rows, and what each row is at most.

        Parameters
        ----------
        tap
            Taps of all regulators in the trajectory, (T, n_regulator).
        at_zero, by_p, by_q
            Relay volts where d and q are 0, (T, n), and slopes, (T, n, n_dc) and (T, n, n_agent).
        """
        keep, beyond = self.in_band, -sparse.identity(self.count, format="csr")
        parts = [sparse.block_diag(list(slopes), format="csr")[keep] for slopes in (by_p, by_q)]
        low, high = (a.ravel()[keep] for a in self.relays.rest_volts(tap[:, self.relays.rows]))
        volts = at_zero.ravel()[keep]
        rows = []
        for sign, room in ((1.0, high - volts), (-1.0, volts - low)):
            limited = np.flatnonzero(np.isfinite(room))  # a tap at its end goes no further
            rows.append((*(sign * part[limited] for part in parts), beyond[limited], room[limited] - _MARGIN_V))
        return rows
