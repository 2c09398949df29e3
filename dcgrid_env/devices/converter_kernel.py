"""Compiled form of ``converter.dispatch``: one pass over the devices where NumPy makes eight."""

from __future__ import annotations

import numpy as np

from dcgrid_env.core.compiled import compiled


@compiled(inner=True)
def dispatch_one(s_rated_kva, q_max_kvar, p_kw, asked_kvar):
    """Return the reactive injection of one converter and its limit, kvar."""
    left = s_rated_kva * s_rated_kva - p_kw * p_kw
    most = np.sqrt(0.0 if left < 0.0 else left)
    most = q_max_kvar if q_max_kvar < most else most
    asked = -most if asked_kvar < -most else asked_kvar
    return (most if asked > most else asked), most


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
            q_kvar[row, i], limit[row, i] = dispatch_one(
                s_rated_kva[i], q_max_kvar[i], p_kw[row, i], q_setpoint_kvar[row, i]
            )
    return q_kvar, limit
