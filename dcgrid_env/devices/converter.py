"""The grid-side converter of a data centre or an inverter: reactive power within what active power leaves of it.

|q| <= min(q_max, sqrt(s_rated^2 - p^2))
"""

from __future__ import annotations

from dcgrid_env.core.arrays import Array, namespace, positive_sqrt
from dcgrid_env.core.twins import compiled_as


@compiled_as("dcgrid_env.devices.converter_kernel:dispatch_rows", like="p_kw")
def dispatch(s_rated_kva: Array, q_max_kvar: Array, p_kw: Array, q_setpoint_kvar: Array) -> tuple[Array, Array]:
    """Reactive injection and its limit, kvar, for an active power of ``p_kw``; all arrays (..., n_device)."""
    xp = namespace(p_kw)
    limit = xp.minimum(positive_sqrt(s_rated_kva * s_rated_kva - p_kw * p_kw), q_max_kvar)
    return xp.minimum(xp.maximum(q_setpoint_kvar, -limit), limit), limit
