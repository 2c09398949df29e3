"""What is known of the paper: its cases, and the figures that it reports.

Its Table I as a whole, and the recordings behind its Figs. 1 and 2, were not at hand: where a cell is not among the
figures here, none is given.
"""

from __future__ import annotations

CITATION = 'Y. Chen and B. Zhang, "Voltage Regulation in Distribution Systems with Data Center Loads", arXiv 2507.06416'
RECORDING = "chen-zhang-2025-inference"
"""Name of the recording that the paper published."""

COUNTS = (1, 2, 3, 4, 5)
"""Data centres in Table I."""
K_P_MW_PER_PU = (1.0, 10.0, 20.0)
"""Active gains in Table I."""
PUBLISHED_BUSES = (13, 24, 28, 37, 53, 77, 85, 99)
"""Data-centre buses named in the paper's public code."""

LARGEST_MEAN_PU = 0.03
"""Bound on the mean abs(V - 1) in all cases."""
FIVE_SITES_PU = (0.024, 0.034)
"""Mean abs(V - 1) with five data centres: with the method, and what it is held against."""
GAIN_PCT = 12.8
"""Average gain of the method over inverters only."""
BUSES_INSIDE_PCT = 97.0
"""Buses always within the band: over this share."""
BAND_PU = 0.05
