"""What every power-flow method returns."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.arrays import Array, as_like, namespace
from dcgrid_env.feeder.feeder import Feeder

V_SQ_FLOOR = 1e-4
"""A squared voltage this low is no operating point: the iteration is on its way to collapse."""
V_SQ_CEILING = 1e4
"""Nor is one this high: an iteration under impossible injections runs away upwards."""


class PowerFlowError(ValueError):
    """Input that no power flow can use. A load without a solution is not an error: see ``Solution.converged``."""


class Solution(NamedTuple):
    """Voltages and flows of a batch of feeders; leading dimensions are those of the loads.

    Where ``converged`` is False no solution was found, most likely because there is none: the load is beyond what the
    feeder can carry. Voltages and flows are then finite but no solution, and the residual may be infinite.
    """

    v_pu: Array
    """Voltage magnitude, p.u., shape (..., n_bus)."""
    p_branch_kw: Array
    """Active power into the sending end of branch k, kW, shape (..., n_bus - 1)."""
    q_branch_kvar: Array
    """Reactive power into the sending end of branch k, kvar, shape (..., n_bus - 1)."""
    current_sq_pu: Array
    """Squared current of branch k, per unit, shape (..., n_bus - 1): what a warm start takes."""
    loss_kw: Array
    """Active loss of all branches, kW, shape (...)."""
    converged: Array
    """Whether the residual is within the tolerance, bool, shape (...)."""
    iterations: Array
    """Sweeps done, int, shape (...)."""
    residual_kva: Array
    """Largest power mismatch at any bus, kVA, shape (...)."""


_HOST = (np.ndarray, np.generic)
_FLOATS = (np.float64, np.float32)


def check_loads(feeder: Feeder, p_kw: Any, q_kvar: Any) -> tuple[Array, Array]:
    """Both loads as arrays of one kind and precision; PowerFlowError unless both have the same shape (..., n_bus)."""
    if not hasattr(p_kw, "shape") or isinstance(p_kw, _HOST):
        if hasattr(q_kvar, "shape") and not isinstance(q_kvar, _HOST):
            raise PowerFlowError("p_kw is a NumPy array and q_kvar is not; give both as the same kind of array")
        p_kw, q_kvar = np.asarray(p_kw), np.asarray(q_kvar)
        if p_kw.dtype.type not in _FLOATS or not p_kw.dtype.isnative:
            p_kw = p_kw.astype(np.float32 if p_kw.dtype.type is np.float32 else np.float64)
        if q_kvar.dtype != p_kw.dtype:
            q_kvar = q_kvar.astype(p_kw.dtype)
    else:
        xp = namespace(p_kw)
        if isinstance(q_kvar, _HOST) or not hasattr(q_kvar, "shape") or namespace(q_kvar) is not xp:
            raise PowerFlowError(
                f"p_kw is a {type(p_kw).__name__} and q_kvar is not; give both as the same kind of array"
            )
        dtype = xp.float32 if p_kw.dtype == xp.float32 else xp.float64
        p_kw, q_kvar = (x if x.dtype == dtype else xp.astype(x, dtype) for x in (p_kw, q_kvar))
    if p_kw.shape != q_kvar.shape or p_kw.ndim == 0 or p_kw.shape[-1] != feeder.n_bus:
        raise PowerFlowError(
            f"feeder {feeder.name!r}: p_kw has shape {tuple(p_kw.shape)} and q_kvar {tuple(q_kvar.shape)}; both must "
            f"be (..., {feeder.n_bus}), one figure for each of bus_ids"
        )
    return p_kw, q_kvar


def substation_voltage(feeder: Feeder, p_kw: Array, v0_pu: Any) -> Array:
    """``v0_pu`` (the feeder's own if None) with the loads' kind and leading shape; PowerFlowError unless positive."""
    v0_pu = feeder.v0_pu if v0_pu is None else v0_pu
    if isinstance(v0_pu, float) and isinstance(p_kw, np.ndarray) and 0.0 < v0_pu < np.inf:
        return _filled(p_kw.shape[:-1], v0_pu, p_kw.dtype)
    xp, v0 = namespace(p_kw), as_like(v0_pu, p_kw)
    if not bool(xp.all((v0 > 0) & (v0 < xp.inf))):
        raise PowerFlowError(f"feeder {feeder.name!r}: v0_pu is {v0_pu}; give a positive substation voltage in p.u.")
    try:
        return xp.broadcast_to(v0, p_kw.shape[:-1])
    except (ValueError, RuntimeError):
        shapes = f"{tuple(v0.shape)} for loads of shape {tuple(p_kw.shape)}"
        raise PowerFlowError(f"v0_pu has shape {shapes}; give a number or the loads' leading shape") from None


@lru_cache(maxsize=64)
def _filled(shape: tuple[int, ...], value: float, dtype: Any) -> Any:
    return np.full(shape, value, dtype)


def raise_not_finite(feeder: Feeder, p_kw: Array, q_kvar: Array) -> None:
    """Find the load that is not finite and raise PowerFlowError naming bus and field; return if there is none."""
    xp = namespace(p_kw)
    for field, values in (("p_kw", p_kw), ("q_kvar", q_kvar)):
        where = xp.nonzero(~xp.isfinite(values))
        if len(where[0]):
            at = tuple(int(i[0]) for i in where)
            raise PowerFlowError(
                f"feeder {feeder.name!r}: {field} of bus {feeder.bus_ids[at[-1]]} is {values[at].item()} in scenario "
                f"{at[:-1]} of the batch; give finite loads"
            )
