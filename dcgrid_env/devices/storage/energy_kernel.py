"""Compiled form of ``energy_balance.step``: one pass over the storages where NumPy makes some twenty."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled
def step_rows(figures, share, before, asked_kw, connected, hours):
    """State after an interval as the rows of (7, row, slot), in the order of ``StorageState``.

    The bits are those of the array form. NaN and infinity stay so.
    """
    p_rated, energy, charge_efficiency, discharge_efficiency, returned = figures
    stored_before, charge_limit, discharge_limit, throughput, loss = before
    out = np.empty((7, *asked_kw.shape))
    for row in range(asked_kw.shape[0]):
        for i in range(asked_kw.shape[1]):
            p = asked_kw[row, i]
            p = charge_limit[row, i] if p > charge_limit[row, i] else p
            p = -discharge_limit[row, i] if p < -discharge_limit[row, i] else p
            if connected is not None:
                p = p * connected[row, i]
            charged, discharged = 0.0 if p < 0.0 else p, 0.0 if p > 0.0 else -p
            gained = charged * charge_efficiency[i] - discharged / discharge_efficiency[i]
            stored = stored_before[row, i] * share[i] + gained * hours
            stored = 0.0 if stored < 0.0 else stored
            stored = energy[i] if stored > energy[i] else stored
            kept = stored * share[i]
            room_kw = (energy[i] - kept) / (charge_efficiency[i] * hours)
            left_kw = kept * discharge_efficiency[i] / hours
            out[0, row, i] = stored
            out[1, row, i] = p
            out[2, row, i] = p_rated[i] if p_rated[i] < room_kw else room_kw
            out[3, row, i] = p_rated[i] if p_rated[i] < left_kw else left_kw
            out[4, row, i] = throughput[row, i] + (charged + discharged) * hours
            out[5, row, i] = loss[row, i] + p * hours - (stored - stored_before[row, i])
            lacking = returned[i] - stored
            out[6, row, i] = 0.0 if lacking < 0.0 else lacking
    return out
