"""The grid-side converter of a data centre or an inverter: reactive power within what active power leaves of it.

|q| <= min(q_max, sqrt(s_rated^2 - p^2))
"""

from __future__ import annotations

from functools import cache
from typing import Any

from dcgrid_env.core.arrays import Array, is_rows, namespace, positive_sqrt


def dispatch(s_rated_kva: Array, q_max_kvar: Array, p_kw: Array, q_setpoint_kvar: Array) -> tuple[Array, Array]:
    """Reactive injection and its limit, kvar, for an active power of ``p_kw``; all arrays (..., n_device)."""
    if is_rows(p_kw) and is_rows(q_setpoint_kvar):
        return _kernel().dispatch_lanes(s_rated_kva, q_max_kvar, p_kw, q_setpoint_kvar)
    xp = namespace(p_kw)
    limit = xp.minimum(positive_sqrt(s_rated_kva * s_rated_kva - p_kw * p_kw), q_max_kvar)
    return xp.minimum(xp.maximum(q_setpoint_kvar, -limit), limit), limit


@cache
def _kernel() -> Any:
    """The compiled form, imported on first use: it brings the compiler with it."""
    from dcgrid_env.devices import converter_kernel

    return converter_kernel
