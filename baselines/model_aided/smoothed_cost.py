"""The cost of voltages with its kinks rounded, and its slope, compiled, for the search of ``static_optimum``."""

# pyright: basic
from __future__ import annotations

import math

import numpy as np

from dcgrid_env.core.compiled import compiled

_FAR = 40.0  # half widths from a kink at which its rounding is beyond double precision


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def smoothed_cost(e, by_voltage, by_violation, band_pu, smooth_pu):
    """Sum over deviations e, p.u., of m moments and k buses, (m, k), with kinks rounded over ``smooth_pu``.

    The second is its derivative when a bus moves at all moments, (k,).
    """
    sizes, beyond, slope = 0.0, 0.0, np.zeros(e.shape[1])
    for i in range(e.shape[0]):
        row, furthest = e[i], 0.0
        for k in range(len(row)):
            size = math.sqrt(row[k] * row[k] + smooth_pu * smooth_pu)
            sizes += size
            slope[k] += by_voltage * row[k] / size
            furthest = max(furthest, abs(row[k]))
        if furthest < band_pu - _FAR * smooth_pu:
            continue
        for k in range(len(row)):
            past = (abs(row[k]) - band_pu) / smooth_pu
            if past > -_FAR:
                z = math.exp(-abs(past))
                beyond += max(past, 0.0) + math.log1p(z)
                slope[k] += by_violation * math.copysign((1.0 if past > 0.0 else z) / (1.0 + z), row[k])
    return by_voltage * sizes + by_violation * smooth_pu * beyond, slope
