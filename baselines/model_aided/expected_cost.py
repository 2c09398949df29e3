"""The expected cost of voltages that are known up to a normal error, and its slope.

    E[w |V - 1| + W max(|V - 1| - band, 0)] for V normal around V^ with standard deviation s has, with e = V^ - 1, the
    derivative by V^

        w (2 Phi(e / s) - 1) + W (Phi((e - band) / s) - Phi(-(e + band) / s))

Phi is the standard normal distribution. The error smooths both kinks, so the slope rises through the band's edge
before the edge is reached. This is the price of uncertainty. Deviations are those from 1 p.u. even if the scenario has
another form or reference of the voltage cost.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from dcgrid_env import Scenario


class VoltagePrice(NamedTuple):
    """What a deviation costs, for a bus."""

    voltage: float
    """Weight of |V - 1| of one bus."""
    violation: float
    """Weight of what is beyond the band."""
    band_pu: float

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> VoltagePrice:
        """The prices of a scenario, the mean over its buses taken apart."""
        w, n = scenario.cost.weights, len(scenario.feeder.load_nodes)
        return cls(w.voltage / n, w.violation / n, scenario.cost.band_pu)

    def slope(self, v_pu: np.ndarray, s_pu: np.ndarray) -> np.ndarray:
        """Derivative of the expected cost by the expected voltage, per p.u., in the shape of both."""
        e = (v_pu - 1.0) / s_pu
        b = self.band_pu / s_pu
        return self.voltage * (2.0 * ndtr(e) - 1.0) + self.violation * (ndtr(e - b) - ndtr(-e - b))
