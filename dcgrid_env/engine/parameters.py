"""A scenario's fixed figures as arrays of one kind, so that the physics runs on NumPy arrays and tensors alike."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.devices import Q
from dcgrid_env.scenario.scenario import Scenario


class Setting(NamedTuple):
    """How an action in [-1, 1] becomes the setpoint of a channel: middle + half of the range times action."""

    middle: Array
    half_range: Array
    rest: Array
    """Setpoint at t = 0; each (slot,)."""


class Parameters(NamedTuple):
    """Arrays over slots; agents are ordered as the scenario's devices are."""

    devices: tuple[Any, ...]
    """Each device's own parameters."""
    settings: tuple[tuple[Setting, ...], ...]
    """For each device those of its channels in their order, but for the reactive one."""
    p_scale_kw: Array
    """Rating that a draw is a share of, kW or kVA, (n_agent,)."""
    q_scale_kvar: Array
    """Reactive limit at zero active power, kvar, (n_agent,)."""
    per_q_scale: Array
    """1 / q_scale_kvar, and 0 for a device without reactive power."""
    converter_kva: Array
    """Apparent-power rating, which reactive effort is a share of, kVA, (n_agent,)."""
    one: Array
    minus_one: Array
    """1 and -1 without dimensions: tensors take no plain number in minimum and maximum."""
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
def _parameters(scenario: Scenario, xp: Any, dtype: Any, device: Any) -> Parameters:
    def array(values: Any) -> Array:
        return xp.asarray(np.array(values, dtype=np.float64), dtype=dtype, device=device)

    def setting(channel: Any) -> Setting:
        middle, half = 0.5 * (channel.highest + channel.lowest), 0.5 * (channel.highest - channel.lowest)
        return Setting(array(middle), array(half), array(channel.rest))

    groups = scenario.devices
    drawing = sum(float(group.p_scale_kw.sum()) for group in groups if group.input == "workload")
    return Parameters(
        devices=tuple(type(group.parameters)(*map(array, group.parameters)) for group in groups),
        settings=tuple(tuple(setting(c) for c in group.channels if c.name != Q) for group in groups),
        p_scale_kw=array(np.concatenate([group.p_scale_kw for group in groups])),
        q_scale_kvar=array(scenario.q_scale_kvar),
        per_q_scale=array(inverse(scenario.q_scale_kvar)),
        converter_kva=array(np.concatenate([group.converter_kva for group in groups])),
        one=array(1.0),
        minus_one=array(-1.0),
        p_all_kw=float(drawing + np.abs(scenario.feeder.p_load_kw).sum()) or 1.0,
    )
