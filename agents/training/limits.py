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
    """Limits that a policy must meet while it minimises the other costs; None for no limit."""

    delay_s: float | None
    """Mean delay, s."""
    violation_pu: float | None
    """Mean excess of the voltage over the band, p.u."""

    def merit(self, figures: Mapping[str, float]) -> float:
        """Return the selection criterion, smallest for the best policy: J without limited costs, with a penalty."""
        left, beyond = figures["J"], 0.0
        if self.delay_s is not None:
            left -= figures["J_waiting"]
            beyond += max(figures["delay_mean_s"] / self.delay_s - 1.0, 0.0)
        if self.violation_pu is not None:
            left -= figures["J_violation"]
            beyond += max(figures["excess_mean_pu"] / self.violation_pu - 1.0, 0.0)
        return left * (1.0 + 10.0 * beyond)


def updated_factor(factor: float, limit: float | None, measured: float, rate: float) -> float:
    """Update a price factor in proportion to ``rate`` and the relative distance from its limit.

    Without a limit the factor does not change.
    """
    if limit is None:
        return factor
    off = min(max(measured / limit - 1.0, -1.0), 1.0)
    return min(max(factor * math.exp(rate * off), SMALLEST_FACTOR), LARGEST_FACTOR)
