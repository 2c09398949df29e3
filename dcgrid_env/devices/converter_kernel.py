"""Compiled form of ``converter.dispatch``: one pass over the devices where NumPy makes eight."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled
def dispatch_rows(s_rated_kva, q_max_kvar, p_kw, q_setpoint_kvar):
    """Return the reactive injection and its limit, kvar, (row, n_device).

    Ratings have the shape (n_device,), powers (row, n_device). The results are identical to those of the array form to
    the bit, and figures that are not finite remain so.
    """
    limit = np.empty_like(p_kw)
    q_kvar = np.empty_like(p_kw)
    for row in range(p_kw.shape[0]):
        for i in range(p_kw.shape[1]):
            left = s_rated_kva[i] * s_rated_kva[i] - p_kw[row, i] * p_kw[row, i]
            most = np.sqrt(0.0 if left < 0.0 else left)
            most = q_max_kvar[i] if q_max_kvar[i] < most else most
            asked = q_setpoint_kvar[row, i]
            asked = -most if asked < -most else asked
            limit[row, i] = most
            q_kvar[row, i] = most if asked > most else asked
    return q_kvar, limit
