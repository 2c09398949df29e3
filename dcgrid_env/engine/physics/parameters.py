"""A scenario's fixed figures as arrays of one kind, so that the physics runs on NumPy arrays and tensors alike."""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices import Q
from dcgrid_env.devices.device import Device
from dcgrid_env.engine.physics.actions import action_layout
from dcgrid_env.grid import AnyFeeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.scenario import Scenario


class Parameters(NamedTuple):
    """Arrays over slots; agents are ordered as the scenario's devices are."""

    devices: tuple[Any, ...]
    """Each device's own parameters."""
    middle: Array
    half_range: Array
    """Half of the range, (n_action,): an action in [-1, 1] gives the set point ``middle + half_range * action``."""
    rest: tuple[tuple[Array, ...], ...]
    """Set points at t = 0 for each device, of all channels except the reactive one, (slot,) each."""
    reactive: Array
    """Entry of each agent's reactive setpoint, int, (n_agent,); any for an agent without one."""
    has_reactive: Array | None
    """1 for an agent with a reactive channel and 0 for one without, (n_agent,); None where all have one."""
    p_scale_kw: Array
    """Rating that a draw is a share of, kW or kVA, (n_agent,)."""
    q_scale_kvar: Array
    """Reactive limit at zero active power, kvar, (n_agent,)."""
    per_q_scale: Array
    """1 / q_scale_kvar, and 0 for a device without reactive power."""
    converter_kva: Array
    """Apparent-power rating, which reactive effort is a share of, kVA, (n_agent,)."""
    p_all_kw: float
    """Sum of the feeder's base load and the ratings of devices that draw, kW, which losses are a share of."""


def inverse(values: np.ndarray) -> np.ndarray:
    """1 / values, and 0 where they are 0."""
    return np.divide(1.0, values, out=np.zeros_like(values), where=values > 0)


def parameters(scenario: Scenario, like: Array) -> Parameters:
    """The parameters as arrays of the kind, precision and device of ``like``; made once for each."""
    if isinstance(like, np.ndarray) and like.dtype == np.float64:
        return _on_numpy(scenario)
    return _parameters(scenario, namespace(like), like.dtype, like.device)


@cached_on_owner
def _on_numpy(scenario: Scenario) -> Parameters:
    """The common case with a shorter key: this is asked several times a step."""
    like = np.empty(0)
    return _parameters(scenario, namespace(like), like.dtype, like.device)


@cached_on_owner
def _parameters(scenario: Scenario, xp: ModuleType, dtype: object, device: object) -> Parameters:
    def array(values: Array) -> Array:
        return xp.asarray(np.array(values, dtype=np.float64), dtype=dtype, device=device)

    groups = scenario.devices
    middle, half_range = (np.concatenate([values(g).ravel() for g in groups]) for values in (_middle, _half_range))
    reactive = action_layout(scenario).reactive
    has_reactive = reactive >= 0
    drawing = sum(float(group.p_scale_kw.sum()) for group in groups if group.input == "workload")
    return Parameters(
        devices=tuple(type(group.parameters)(*map(array, group.parameters)) for group in groups),
        middle=array(middle),
        half_range=array(half_range),
        rest=tuple(tuple(array(c.rest) for c in group.channels if c.name != Q) for group in groups),
        reactive=xp.asarray(np.maximum(reactive, 0), device=device),
        has_reactive=None if has_reactive.all() else array(has_reactive),
        p_scale_kw=array(np.concatenate([group.p_scale_kw for group in groups])),
        q_scale_kvar=array(scenario.q_scale_kvar),
        per_q_scale=array(inverse(scenario.q_scale_kvar)),
        converter_kva=array(np.concatenate([group.converter_kva for group in groups])),
        p_all_kw=float(drawing + _load_kw(scenario.family.feeder)) or 1.0,
    )


def _load_kw(feeder: AnyFeeder) -> float:
    """Sum of a feeder's base load, kW; random feeders all have the same."""
    return feeder.load_kw if isinstance(feeder, RandomFeeders) else float(np.abs(feeder.p_load_kw).sum())


def _middle(device: Device) -> np.ndarray:
    """The middle of each channel's range, (slot, channel); 0 of a reactive one."""
    return _by_slot(device, [0.0 if c.name == Q else 0.5 * (c.highest + c.lowest) for c in device.channels])


def _half_range(device: Device) -> np.ndarray:
    """Half of each channel's range, (slot, channel); of a reactive one the limit at zero active power."""
    halves = [device.q_limit_kvar if c.name == Q else 0.5 * (c.highest - c.lowest) for c in device.channels]
    return _by_slot(device, halves)


def _by_slot(device: Device, values: list[Any]) -> np.ndarray:
    """Values of each channel as (slot, channel)."""
    return (
        np.stack([np.broadcast_to(v, (device.count,)) for v in values], -1) if values else np.zeros((device.count, 0))
    )
