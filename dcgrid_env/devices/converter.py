"""The grid-side converter of a data centre or an inverter: reactive power within what active power leaves of it.

|q| <= min(q_max, sqrt(s_rated^2 - p^2))
"""

from __future__ import annotations

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.formula import PerSlot, formula, least, most, root


@formula
def limit(s_rated_kva: PerSlot, q_max_kvar: PerSlot, p_kw: Array) -> Array:
    """Largest reactive power, kvar, for an active power of ``p_kw``."""
    return least(root(s_rated_kva * s_rated_kva - p_kw * p_kw), q_max_kvar)


@formula(like="p_kw")
def dispatch(s_rated_kva: PerSlot, q_max_kvar: PerSlot, p_kw: Array, q_setpoint_kvar: Array) -> tuple[Array, Array]:
    """Reactive injection and its limit, kvar, for an active power of ``p_kw``; all arrays (..., n_device)."""
    largest = limit(s_rated_kva, q_max_kvar, p_kw)
    return least(most(q_setpoint_kvar, -largest), largest), largest
