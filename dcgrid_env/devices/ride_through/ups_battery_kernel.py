"""The compiled form of ``ups_battery.step``: one pass over rows and slots, with the bits of the array form."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled
def supplied(
    stored_kws, share, p_kw, p_idle_kw, served_kw, p_rated_kw, battery_s, recharge_share, efficiency, serves, dt_s
):
    """See ``ups_battery._supplied``."""
    rows, slots = share.shape
    after, battery, recharge = np.empty_like(share), np.empty_like(share), np.empty_like(share)
    work, grid, works = np.empty_like(share), np.empty_like(share), np.empty_like(share)
    for i in range(rows):
        for j in range(slots):
            on_grid, stored, p = share[i, j], stored_kws[i, j], p_kw[i, j]
            full = p_rated_kw[j] * battery_s
            b = min((1.0 - on_grid) * (p if serves else p_idle_kw[i, j]), stored / dt_s)
            done = on_grid
            if serves:
                done = (on_grid * p + b) / p if p > 0.0 else 1.0
            c = 0.0
            if on_grid >= 1.0:
                most = min(p_rated_kw[j] * recharge_share, max(full - stored, 0.0) / (efficiency * dt_s))
                c = min(most, max(p_rated_kw[j] - p, 0.0))
            done = min(done, 1.0)  # beyond 1 by rounding
            after[i, j] = min(max(stored - b * dt_s, 0.0) + efficiency * dt_s * c, full)
            battery[i, j], recharge[i, j], works[i, j] = b, c, done
            work[i, j] = (done - on_grid) * served_kw[i, j]
            grid[i, j] = on_grid * p + c
    return after, battery, recharge, work, grid, works
