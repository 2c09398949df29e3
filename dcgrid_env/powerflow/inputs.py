"""Inputs of a power flow, checked and converted to arrays of one kind; errors name the invalid input."""

from __future__ import annotations

import math
import reprlib
from functools import lru_cache
from typing import Any

import numpy as np
from array_api_compat import is_array_api_obj

from dcgrid_env.core.arrays import Array, as_like, namespace
from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.three_phase import ThreePhaseFeeder
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.solution import PowerFlowError, Solution

_MOST_SWEEPS = 2**31 - 1

_FLOATS = (np.dtype(np.float64), np.dtype(np.float32))
_WANTED = {
    "p_kw": "give active power alone, real numbers in kW",
    "q_kvar": "give reactive power alone, real numbers in kvar",
    "v0_pu": "give a positive substation voltage in p.u.",
    "warm": "give a Solution or its restart",
    "shunt_kvar": "give reactive injections alone, real numbers in kvar",
    "tap_ratio": "give ratios, real numbers: feeder.tap_ratio(tap) makes them of taps",
    "capacitor_on": "give numbers from 0 (off) to 1 (on)",
}


def check_feeder(feeder: object) -> None:
    """PowerFlowError unless it is a Feeder."""
    if not isinstance(feeder, Feeder):
        raise PowerFlowError(f"feeder is {reprlib.repr(feeder)}; give a Feeder, for instance load_feeder('ieee33')")


def check_loads(feeder: Feeder, p_kw: Array, q_kvar: Array) -> tuple[Array, Array]:
    """Both loads as arrays of one kind and precision; PowerFlowError unless both have the same shape (..., n_node)."""
    if not (type(p_kw) is type(q_kvar) is np.ndarray and p_kw.dtype == q_kvar.dtype and p_kw.dtype in _FLOATS):
        p_kw, q_kvar = of_one_kind(figures(feeder, "p_kw", p_kw), figures(feeder, "q_kvar", q_kvar))
    if p_kw.shape != q_kvar.shape or p_kw.ndim == 0 or p_kw.shape[-1] != feeder.n_node:
        raise PowerFlowError(
            f"feeder {feeder.name!r}: p_kw has shape {tuple(p_kw.shape)} and q_kvar {tuple(q_kvar.shape)}; both must "
            f"be (..., {feeder.n_node}), one figure for each of bus_ids"
        )
    return p_kw, q_kvar


def substation_voltage(feeder: Feeder | ThreePhaseFeeder, p_kw: Array, v0_pu: Array | float | None) -> Array:
    """``v0_pu`` (the feeder's own if None) with the loads' kind and leading shape; PowerFlowError unless positive."""
    v0_pu = feeder.v0_pu if v0_pu is None else v0_pu
    if isinstance(v0_pu, float) and isinstance(p_kw, np.ndarray) and 0.0 < v0_pu < np.inf:
        return _filled(p_kw.shape[:-1], v0_pu, p_kw.dtype)
    xp, v0 = namespace(p_kw), like_loads("v0_pu", figures(feeder, "v0_pu", v0_pu), p_kw)
    if not bool(xp.all((v0 > 0) & (v0 < xp.inf))):
        raise PowerFlowError(f"feeder {feeder.name!r}: v0_pu is {reprlib.repr(v0_pu)}; {_WANTED['v0_pu']}")
    try:
        return xp.broadcast_to(v0, p_kw.shape[:-1])
    except (ValueError, RuntimeError):
        shapes = f"{tuple(v0.shape)} for loads of shape {tuple(p_kw.shape)}"
        raise PowerFlowError(f"v0_pu has shape {shapes}; give a number or the loads' leading shape") from None


def warm_start(feeder: Feeder, p_kw: Array, warm: Array | None) -> Array | None:
    """Return the figures to start from, of the loads' kind; PowerFlowError unless their shape fits the loads.

    They are the squared current of each branch, per unit. On a feeder with loops they are also the active and reactive
    power through each break point, per unit: shape (..., n_branch + 2 n_loop). They need not be finite, because the
    sweeps restart from zero if a start cannot be used.
    """
    if warm is None:
        return None
    start = warm.restart if isinstance(warm, Solution) else warm
    if not (type(start) is np.ndarray and type(p_kw) is np.ndarray and start.dtype == p_kw.dtype):
        start = like_loads("warm", figures(feeder, "warm", start), p_kw)
    wanted = (*p_kw.shape[:-1], feeder.n_branch + 2 * feeder.n_loop)
    if tuple(start.shape) != wanted:
        raise PowerFlowError(f"warm start has shape {tuple(start.shape)}; for these loads it must be {wanted}")
    return start


def less_switched_shunts(feeder: Feeder, p_kw: Array, q_kvar: Array, control: Control) -> Array:
    """Return reactive loads of a balanced feeder minus the injection of switched shunts.

    Raises PowerFlowError for a tap or capacitor state, or a wrong shape. A switched shunt injects its rating at any
    voltage, as the feeder's fixed capacitors do.
    """
    for field, component in (("tap_ratio", "regulator"), ("capacitor_on", "bank of capacitors")):
        value = getattr(control, field)
        if value is not None:
            raise PowerFlowError(
                f"feeder {feeder.name!r}: {field} is {reprlib.repr(value)}, and a balanced feeder has no {component}; "
                f"leave {field} at None"
            )
    _, q_kvar = check_loads(feeder, p_kw, q_kvar)
    if control.shunt_kvar is None:
        return q_kvar
    shunt = like_loads("shunt_kvar", figures(feeder, "shunt_kvar", control.shunt_kvar), q_kvar)
    if tuple(shunt.shape) not in (tuple(q_kvar.shape), (feeder.n_node,)):
        raise PowerFlowError(
            f"feeder {feeder.name!r}: shunt_kvar has shape {tuple(shunt.shape)}; give one figure for each node, "
            f"{(feeder.n_node,)}, or the shape of the loads, {tuple(q_kvar.shape)}"
        )
    return q_kvar - shunt


def check_stop(tolerance_kva: Any, max_sweeps: Any) -> None:
    """PowerFlowError unless the tolerance, kVA, is positive (or None) and the sweeps can be counted."""
    whole = type(max_sweeps) is int or (isinstance(max_sweeps, np.integer))
    if not whole or not 1 <= max_sweeps <= _MOST_SWEEPS:
        raise PowerFlowError(f"max_sweeps is {reprlib.repr(max_sweeps)}; give a whole number from 1 to {_MOST_SWEEPS}")
    if tolerance_kva is None:
        return
    real = isinstance(tolerance_kva, int | float | np.integer | np.floating) and not isinstance(tolerance_kva, bool)
    if not real or not 0.0 < tolerance_kva < math.inf:
        raise PowerFlowError(
            f"tolerance_kva is {reprlib.repr(tolerance_kva)}; give a positive number of kVA, or None for the default"
        )


def figures(feeder: Feeder | ThreePhaseFeeder, name: str, values: Array) -> Array:
    """Take an argument as an array of real numbers, NumPy's unless it is of another library; PowerFlowError else."""
    if isinstance(values, np.ma.MaskedArray):
        raise PowerFlowError(
            f"feeder {feeder.name!r}: {name} is a masked array, and a power flow needs every figure; fill it, for "
            f"instance {name}.filled(0.0)"
        )
    if hasattr(values, "shape") and not is_array_api_obj(values) and not isinstance(values, np.generic):
        raise PowerFlowError(
            f"feeder {feeder.name!r}: {name} is a {type(values).__name__}; give a NumPy array, a list or a torch tensor"
        )
    array: Array = values
    if not is_array_api_obj(values):
        try:
            array = np.asarray(values)
        except (ValueError, TypeError, RuntimeError) as error:
            raise PowerFlowError(f"feeder {feeder.name!r}: {name} is no array ({error}); {_WANTED[name]}") from None
    if not _is_dense(array):
        raise PowerFlowError(f"feeder {feeder.name!r}: {name} is a sparse tensor; give {name}.to_dense()")
    if not _is_real(array):
        raise PowerFlowError(
            f"feeder {feeder.name!r}: {name} is {reprlib.repr(array.tolist())}, of dtype {array.dtype}; {_WANTED[name]}"
        )
    return array


def _is_real(values: Array) -> bool:
    if isinstance(values, np.ndarray | np.generic):
        return values.dtype.kind in "fiu"
    return namespace(values).isdtype(values.dtype, ("real floating", "integral"))


def _is_dense(values: Array) -> bool:
    return str(getattr(values, "layout", "torch.strided")) == "torch.strided"


def of_one_kind(p_kw: Array, q_kvar: Array) -> tuple[Array, Array]:
    """Take loads in float32 if both are, else in float64; PowerFlowError where one is NumPy's and the other is not."""
    xp = namespace(p_kw)
    if namespace(q_kvar) is not xp:
        kinds = f"p_kw is a {type(p_kw).__name__} and q_kvar a {type(q_kvar).__name__}"
        raise PowerFlowError(f"{kinds}; give both as the same kind of array")
    if xp is not np and p_kw.device != q_kvar.device:
        raise PowerFlowError(f"p_kw is on {p_kw.device} and q_kvar on {q_kvar.device}; give both on the same device")
    dtype = xp.float32 if p_kw.dtype == q_kvar.dtype == xp.float32 else xp.float64
    if xp is np:
        return p_kw.astype(dtype, copy=False), q_kvar.astype(dtype, copy=False)
    return xp.astype(p_kw, dtype, copy=False), xp.astype(q_kvar, dtype, copy=False)


def like_loads(name: str, values: Array, like: Array) -> Array:
    """Take an argument in the kind, precision and device of the loads; PowerFlowError where NumPy cannot read it."""
    try:
        return as_like(values, like)
    except (TypeError, RuntimeError):  # a tensor that NumPy cannot read: of another device, or recording a derivative
        raise PowerFlowError(
            f"{name} is a {type(values).__name__} that NumPy cannot read, and the loads are NumPy's; give "
            f"{name}.detach().cpu()"
        ) from None


@lru_cache(maxsize=64)
def _filled(shape: tuple[int, ...], value: float, dtype: Any) -> Array:
    return np.full(shape, value, dtype)
