"""Limits on the mean delay and on the violation of the voltage band, kept by multipliers of what they cost.

A limited quantity's price is multiplied by a factor that begins at 1, rises while the limit is exceeded and falls while
it is kept: dual ascent as in C. Tessler, D. Mankowitz and S. Mannor, "Reward constrained policy optimization", arXiv
1805.11074.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

SMALLEST_FACTOR, LARGEST_FACTOR = 1e-3, 1e3


class Limits(NamedTuple):
    """What a policy must keep at the least cost of the rest; None where there is no limit."""

    delay_s: float | None
    """Mean delay, s."""
    violation_pu: float | None
    """Mean excess of the voltage over the band, p.u."""

    def merit(self, figures: Mapping[str, float]) -> float:
        """What the best policy has least of: J less the cost of what is limited, dearly paid beyond the limits."""
        left, beyond = figures["J"], 0.0
        if self.delay_s is not None:
            left -= figures["J_waiting"]
            beyond += max(figures["delay_mean_s"] / self.delay_s - 1.0, 0.0)
        if self.violation_pu is not None:
            left -= figures["J_violation"]
            beyond += max(figures["excess_mean_pu"] / self.violation_pu - 1.0, 0.0)
        return left * (1.0 + 10.0 * beyond)


def updated_factor(factor: float, limit: float | None, measured: float, rate: float) -> float:
    """A multiplier moved by ``rate`` times how far its limit is exceeded or kept, as a share of the limit.

    It stays where there is no limit.
    """
    if limit is None:
        return factor
    off = min(max(measured / limit - 1.0, -1.0), 1.0)
    return min(max(factor * math.exp(rate * off), SMALLEST_FACTOR), LARGEST_FACTOR)
