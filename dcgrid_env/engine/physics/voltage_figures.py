"""What cost and info ask of a step's voltages, compiled: sums over nodes with NumPy's bits, lowest and highest."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.compiled import compiled
from dcgrid_env.engine.physics.state import VoltageFigures


@compiled(inner=True)
def _sums(v_pu, row, first, n, band_pu):
    """Sums of |V - 1| and of its excess over ``n`` nodes, in the order in which ``np.add.reduce`` adds up a row.

    That is pairwise: halves of more than 128, else eight sums side by side, and up to seven figures one by one.
    """
    if n > 128:
        half = n // 2
        half -= half % 8
        d_0, e_0 = _sums(v_pu, row, first, half, band_pu)
        d_1, e_1 = _sums(v_pu, row, first + half, n - half, band_pu)
        return d_0 + d_1, e_0 + e_1
    deviation, excess, whole = 0.0, 0.0, n - n % 8
    if whole:
        d, e = np.zeros(8), np.zeros(8)
        for i in range(first, first + whole, 8):
            for j in range(8):
                off = abs(v_pu[row, i + j] - 1.0)
                beyond = off - band_pu
                d[j] += off
                e[j] += 0.0 if beyond < 0.0 else beyond
        deviation = ((d[0] + d[1]) + (d[2] + d[3])) + ((d[4] + d[5]) + (d[6] + d[7]))
        excess = ((e[0] + e[1]) + (e[2] + e[3])) + ((e[4] + e[5]) + (e[6] + e[7]))
    for i in range(first + whole, first + n):
        off = abs(v_pu[row, i] - 1.0)
        beyond = off - band_pu
        deviation += off
        excess += 0.0 if beyond < 0.0 else beyond
    return deviation, excess


@compiled(nogil=True)
def fill_figures(v_pu, begin, end, first, band_pu, deviation, excess, lowest, highest):
    """Fill the figures, (row,) each, of the rows from ``begin`` up to ``end``, nodes from ``first`` on."""
    for row in range(begin, end):
        deviation[row], excess[row] = _sums(v_pu, row, first, v_pu.shape[1] - first, band_pu)
        low = high = v_pu[row, first]
        for i in range(first + 1, v_pu.shape[1]):
            v = v_pu[row, i]
            low = v if v < low else low
            high = v if v > high else high
        lowest[row], highest[row] = low, high


def voltage_figures(v_pu: Array, first: int, band_pu: float) -> VoltageFigures:
    """The figures of voltages ``v_pu`` (row, n_node), float64 and contiguous, from the node ``first`` on."""
    figures = VoltageFigures(*np.empty((4, len(v_pu))))
    fill_figures(v_pu, 0, len(v_pu), first, band_pu, *figures)
    return figures
