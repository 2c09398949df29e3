"""What cost and info ask of a step's voltages, compiled: sums over nodes with NumPy's bits, lowest and highest."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.compiled import compiled
from dcgrid_env.engine.physics.state import VoltageFigures
from dcgrid_env.scenario.costs import voltage_reference

beyond_band = voltage_reference.beyond_band.scalar
MOST_AT_ONCE = 128
"""Figures that ``np.add.reduce`` adds up without halving the row."""


@compiled(inner=True)
def _sum_up(values, first, n):
    """Sum of ``n`` figures of a row from ``first`` on, at most MOST_AT_ONCE, with the bits of ``np.add.reduce``.

    It adds up eight sums side by side, and then up to seven figures one by one.
    """
    total, whole = 0.0, n - n % 8
    if whole:
        s = np.zeros(8)
        for i in range(first, first + whole, 8):
            for j in range(8):
                s[j] += values[i + j]
        total = ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7]))
    for i in range(first + whole, first + n):
        total += values[i]
    return total


@compiled(inner=True)
def _pairwise_sum(values, first, n):
    """Sum of any number of figures, with the bits of ``np.add.reduce``: halves of more than MOST_AT_ONCE.

    A kernel that calls itself is cached with its caller alone, so only one module can use it.
    """
    if n > MOST_AT_ONCE:
        half = n // 2
        half -= half % 8
        return _pairwise_sum(values, first, half) + _pairwise_sum(values, first + half, n - half)
    return _sum_up(values, first, n)


@compiled(nogil=True)
def fill_figures(v_pu, begin, end, first, band_pu, deviation, excess, lowest, highest):
    """Fill the figures, (row,) each, of the rows from ``begin`` up to ``end``, nodes from ``first`` on."""
    n = v_pu.shape[1]
    off, beyond = np.empty(n), np.empty(n)
    for row in range(begin, end):
        low = high = v_pu[row, first]
        for i in range(first, n):
            v = v_pu[row, i]
            low = v if v < low else low
            high = v if v > high else high
            off[i] = abs(v - 1.0)
            beyond[i] = beyond_band(off[i], band_pu)
        deviation[row], excess[row] = _pairwise_sum(off, first, n - first), _pairwise_sum(beyond, first, n - first)
        lowest[row], highest[row] = low, high


def voltage_figures(v_pu: Array, first: int, band_pu: float) -> VoltageFigures:
    """The figures of voltages ``v_pu`` (row, n_node), float64 and contiguous, from the node ``first`` on."""
    figures = VoltageFigures(*np.empty((4, len(v_pu))))
    fill_figures(v_pu, 0, len(v_pu), first, band_pu, *figures)
    return figures
