"""What is known of the paper: its cases, its Table I, and the figures that its text reports."""

from __future__ import annotations

from typing import NamedTuple

CITATION = 'Y. Chen and B. Zhang, "Voltage Regulation in Distribution Systems with Data Center Loads", arXiv 2507.06416'
RECORDING = "chen-zhang-2025-inference"
"""Name of the recording that the paper published."""

COUNTS = (1, 2, 3, 4, 5)
"""Data centres in Table I."""
K_P_MW_PER_PU = (1.0, 10.0, 20.0)
"""Active gains in Table I."""


class Cell(NamedTuple):
    """A cell of Table I."""

    deviation_pu: float
    """Mean of the voltage deviation."""
    std_pu: float
    """Its standard deviation."""
    delay_s: float
    """Average delay."""


TABLE_ONE = {
    (1, 1.0): Cell(0.020, 0.012, 0.3),
    (1, 10.0): Cell(0.020, 0.013, 6.0),
    (1, 20.0): Cell(0.019, 0.012, 11.2),
    (2, 1.0): Cell(0.021, 0.012, 0.5),
    (2, 10.0): Cell(0.021, 0.013, 5.6),
    (2, 20.0): Cell(0.020, 0.011, 9.2),
    (3, 1.0): Cell(0.026, 0.013, 0.5),
    (3, 10.0): Cell(0.024, 0.013, 6.2),
    (3, 20.0): Cell(0.022, 0.013, 13.7),
    (4, 1.0): Cell(0.027, 0.015, 1.1),
    (4, 10.0): Cell(0.023, 0.013, 6.0),
    (4, 20.0): Cell(0.021, 0.015, 13.8),
    (5, 1.0): Cell(0.028, 0.017, 1.4),
    (5, 10.0): Cell(0.024, 0.016, 6.0),
    (5, 20.0): Cell(0.024, 0.016, 17.5),
}
"""Table I by number of data centres and k_p."""
PUBLISHED_BUSES = (13, 24, 28, 37, 53, 77, 85, 99)
"""Data-centre buses named in the paper's public code."""

LARGEST_MEAN_PU = 0.03
"""Bound on the mean abs(V - 1) in all cases."""
FIVE_SITES_PU = (0.024, 0.034)
"""Mean abs(V - 1) with five data centres: with the method at k_p = 10, and with inverters only."""
GAIN_PCT = 12.8
"""Average gain of the method over inverters only."""
BUSES_INSIDE_PCT = 97.0
"""Buses always within the band: over this share."""
BAND_PU = 0.05
