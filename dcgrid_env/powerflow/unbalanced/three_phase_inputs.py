"""Inputs of a three-phase power flow, checked and converted to arrays of one kind."""

from __future__ import annotations

import reprlib
from typing import Any

import numpy as np

from dcgrid_env.core.arrays import Array, as_like, namespace
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.powerflow.control import Control
from dcgrid_env.powerflow.inputs import figures, like_loads, of_one_kind, substation_voltage
from dcgrid_env.powerflow.solution import PowerFlowError

_ROUNDING = 1e-9  # of a tap, beyond the last one


def check_three_phase_feeder(feeder: object) -> None:
    """PowerFlowError unless it is a ThreePhaseFeeder."""
    if not isinstance(feeder, ThreePhaseFeeder):
        raise PowerFlowError(
            f"feeder is {reprlib.repr(feeder)}; give a ThreePhaseFeeder, for instance load_feeder('ieee13-3ph')"
        )


def check_legs(feeder: ThreePhaseFeeder, p_kw: Array, q_kvar: Array) -> tuple[Array, Array]:
    """Both powers as arrays of one kind and precision; PowerFlowError unless both have the same shape (..., n_leg)."""
    if not (type(p_kw) is type(q_kvar) is np.ndarray and p_kw.dtype == q_kvar.dtype == np.float64):
        p_kw, q_kvar = of_one_kind(figures(feeder, "p_kw", p_kw), figures(feeder, "q_kvar", q_kvar))
    if p_kw.shape != q_kvar.shape or p_kw.ndim == 0 or p_kw.shape[-1] != feeder.n_leg:
        raise PowerFlowError(
            f"feeder {feeder.name!r}: p_kw has shape {tuple(p_kw.shape)} and q_kvar {tuple(q_kvar.shape)}; both must "
            f"be (..., {feeder.n_leg}): {feeder.first_device_leg} legs of loads, then one for each of {feeder.n_node} "
            "nodes"
        )
    return p_kw, q_kvar


def control_inputs(feeder: ThreePhaseFeeder, q_kvar: Array, control: Control | None) -> tuple[Array, Array, Array]:
    """Reactive power less what switched shunts inject, ratios and capacitors' states, of the loads' leading shape.

    Raises
    ------
    PowerFlowError
        For a wrong shape, a ratio beyond the regulator's taps or a state outside 0 to 1, naming it.
    """
    ratio, state = _base(feeder)
    if control is None or all(change is None for change in control):
        lead = tuple(q_kvar.shape[:-1])
        return q_kvar, _spread(ratio, q_kvar, lead), _spread(state, q_kvar, lead)
    if control.shunt_kvar is not None:
        q_kvar = _less_shunts(feeder, q_kvar, control.shunt_kvar)
    lead = tuple(q_kvar.shape[:-1])
    ratios, states = _spread(ratio, q_kvar, lead), _spread(state, q_kvar, lead)
    if control.tap_ratio is not None:
        ratios = _by_row(feeder, "tap_ratio", control.tap_ratio, q_kvar, feeder.n_regulator)
        _check_ratios(feeder, ratios)
    if control.capacitor_on is not None:
        states = _by_row(feeder, "capacitor_on", control.capacitor_on, q_kvar, feeder.n_capacitor)
        _check_range(feeder, "capacitor", "capacitor_on", states, 0.0, 1.0)
    return q_kvar, ratios, states


@cached_on_owner
def _base(feeder: ThreePhaseFeeder) -> tuple[Any, Any]:
    return feeder.tap_ratio(feeder.base_tap), feeder.base_capacitor_on


def _spread(values: Array, like: Array, lead: tuple[int, ...]) -> Array:
    values = values if isinstance(like, np.ndarray) else as_like(values, like)
    return _widened(values, lead, like)


def _less_shunts(feeder: ThreePhaseFeeder, q_kvar: Array, shunt_kvar: Array | None) -> Array:
    xp, n_load = namespace(q_kvar), feeder.first_device_leg
    shunt = _by_row(feeder, "shunt_kvar", shunt_kvar, q_kvar, feeder.n_node)
    return xp.concat((q_kvar[..., :n_load], q_kvar[..., n_load:] - shunt), axis=-1)


def _by_row(feeder: ThreePhaseFeeder, name: str, values: Array, like: Array, width: int) -> Array:
    lead = tuple(like.shape[:-1])
    if type(values) is type(like) is np.ndarray and values.dtype == like.dtype and values.shape == (*lead, width):
        return values
    array = like_loads(name, figures(feeder, name, values), like)
    if tuple(array.shape) not in ((width,), (*lead, width)):
        raise PowerFlowError(
            f"feeder {feeder.name!r}: {name} has shape {tuple(array.shape)}; give ({width},) or {(*lead, width)}"
        )
    return _widened(array, lead, like)


def _widened(values: Array, lead: tuple[int, ...], like: Array) -> Array:
    """Values (n,) or (*lead, n) as (*lead, n)."""
    if lead == (1,):  # a broadcast takes as long as several sweeps of one feeder
        return values.reshape(1, values.shape[-1])
    return namespace(like).broadcast_to(values, (*lead, values.shape[-1]))


def _check_ratios(feeder: ThreePhaseFeeder, ratio: Array) -> None:
    low, high = _ratio_limits(feeder, ratio.dtype.itemsize == 4)
    _check_range(feeder, "regulator", "tap_ratio", ratio, low, high)


@cached_on_owner
def _ratio_limits(feeder: ThreePhaseFeeder, is_single: bool) -> tuple[Any, Any]:
    table, slack = feeder.network.regulator, 1e-6 if is_single else 0.0
    step = np.array(table.tap_step)
    low = 1.0 + step * (np.array(table.tap_min) - _ROUNDING) - slack
    return low, 1.0 + step * (np.array(table.tap_max) + _ROUNDING) + slack


def _check_range(
    feeder: ThreePhaseFeeder,
    kind: str,
    field: str,
    values: Array,
    low: Array,
    high: Array,
) -> None:
    figures_ = values if isinstance(values, np.ndarray) else values.detach().cpu().numpy()
    good = (figures_ >= low) & (figures_ <= high)
    if good.all():
        return
    index = tuple(int(i[0]) for i in np.nonzero(~good))
    value, table = figures_[index], getattr(feeder.network, kind)
    limits = "it must be from 0 to 1"
    if kind == "regulator":
        tap = (value - 1.0) / table.tap_step[index[-1]]
        limits = f"tap {tap:g} is not from {table.tap_min[index[-1]]} to {table.tap_max[index[-1]]}"
    raise PowerFlowError(
        f"feeder {feeder.name!r}: {kind} {table.name[index[-1]]}: {field} is {value} in scenario {index[:-1]} of the "
        f"batch; {limits}"
    )


def source_voltage(feeder: ThreePhaseFeeder, p_kw: Array, source_voltage_pu: Array | float | None) -> Array:
    """Voltage of the ideal source with the loads' kind and leading shape; PowerFlowError unless positive."""
    return substation_voltage(feeder, p_kw, source_voltage_pu)


def voltages_to_start_from(feeder: ThreePhaseFeeder, p_kw: Array, start: Any) -> Array | None:
    """Return what to start from, of the loads' kind; PowerFlowError unless (..., 2 n_unknown) fits the loads."""
    if start is None:
        return None
    start = getattr(start, "restart", start)
    if not (type(start) is np.ndarray and type(p_kw) is np.ndarray and start.dtype == p_kw.dtype):
        start = like_loads("warm", figures(feeder, "warm", start), p_kw)
    wanted = (*p_kw.shape[:-1], 2 * feeder.n_unknown)
    if tuple(start.shape) != wanted:
        raise PowerFlowError(f"start has shape {tuple(start.shape)}; for these loads it must be {wanted}")
    return start


def raise_leg_not_finite(feeder: ThreePhaseFeeder, p_kw: Array, q_kvar: Array) -> None:
    """Find the power that is not finite and raise PowerFlowError naming bus and field; return if there is none."""
    for field, values in (("p_kw", p_kw), ("q_kvar", q_kvar)):
        values = values if isinstance(values, np.ndarray) else values.detach().cpu().numpy()
        where = np.nonzero(~np.isfinite(values))
        if len(where[0]):
            index = tuple(int(i[0]) for i in where)
            leg, n_load = index[-1], feeder.first_device_leg
            subject = (
                f"the device leg of phase {'abc'[feeder.node_phase[leg - n_load] - 1]}"
                if leg >= n_load
                else (f"load {feeder.network.phase_load.name[feeder.load_legs.row[leg]]}")
            )
            raise PowerFlowError(
                f"feeder {feeder.name!r}: {field} of {subject} at bus {feeder.bus_ids[feeder.leg_bus[leg]]} is "
                f"{values[index]} in scenario {index[:-1]} of the batch; give finite powers"
            )
