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
from dcgrid_env.baselines.model_based.voltage_rows import Linear

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

    def limits(self, tap: np.ndarray, volts: Linear) -> list[tuple[dict[str, Any], np.ndarray]]:
        """Parts of the rows by their unknowns d, q and z, and what each row is at most.

        From the taps of all regulators in the trajectory, (T, n_regulator), and the relay volts around it.
        """
        low, high = (side.ravel() for side in self.relays.rest_volts(tap[:, self.relays.rows]))
        at_zero, beyond = volts.at_zero.ravel(), sparse.csr_array(sparse.identity(len(self.in_band)))
        limits = []
        for sign, room in ((1.0, high - at_zero), (-1.0, at_zero - low)):
            limited = self.in_band & np.isfinite(room)  # a tap at its end goes no further
            by_d, by_q = volts.rows(limited, sign)
            by_z = -beyond[limited][:, self.in_band]
            limits.append(({"d": by_d, "q": by_q, "z": by_z}, room[limited] - _MARGIN_V))
        return limits
