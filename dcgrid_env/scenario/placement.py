"""Placement of a scenario's devices: checks of their buses, and the buses that are drawn from."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.devices.device import Device
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.devices.phases import phases_of
from dcgrid_env.grid import AnyFeeder, Feeder, FeederError
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.assembly import GROUPS
from dcgrid_env.scenario.errors import ScenarioError


def free_load_buses(feeder: AnyFeeder, devices: tuple[Any, ...]) -> np.ndarray:
    """Return the positions in ``bus_ids`` where a device may be drawn: load buses without a fixed one.

    On a three-phase feeder they have all three phases, or those that the devices that are drawn are connected to. If no
    load bus has, as on feeders whose loads are at service transformers, any bus with these phases may be drawn.
    """
    devices = tuple(device for device in devices if not is_equipment(device))
    taken = {0, *(feeder.index(bus) for device in devices for bus in device.buses or ())}
    if isinstance(feeder, Feeder):
        loaded = np.flatnonzero(feeder.p_load_kw > 0)
    else:
        drawn = [device for device in devices if device.buses is None]
        needed = {phase for device in drawn for phases in phases_of(device) for phase in phases or "abc"}
        with_load = np.unique(feeder.leg_bus[feeder.p_load_kw > 0])
        fits = np.array([needed <= set(phases) for phases in feeder.bus_phases])
        loaded = with_load[fits[with_load]]
        loaded = loaded if len(loaded) else np.flatnonzero(fits)
    return np.array([i for i in loaded if i not in taken], dtype=np.int64)


def check_placement(name: str, feeder: AnyFeeder | RandomFeeders, devices: tuple[Any, ...]) -> None:
    """Raise ScenarioError unless every device can have a separate bus, not the substation; equipment takes none.

    A group with a class attribute ``shares_bus`` that is True may share buses with devices of other kinds.
    """
    fixed: list[tuple[str, str, Any, str | None]] = []
    drawn = 0
    for device in reversed([device for device in devices if not is_equipment(device)]):
        if device.buses is None:
            drawn += device.count
            continue
        where = path_of(device)
        if not isinstance(device.buses, tuple) or len(device.buses) != device.count:
            raise ScenarioError(
                f"scenario {name!r}: {where}.count is {device.count}, but {where}.buses is {device.buses!r}; give "
                "both, as many buses as the count, or buses alone, or buses None to have them drawn"
            )
        among = device.kind if getattr(device, "shares_bus", False) else ""
        fixed += ((among, where, bus, phases) for bus, phases in zip(device.buses, phases_of(device), strict=True))
    taken: set[tuple[str, int]] = set()
    for among, where, bus, phases in fixed:
        bus_index = _position(name, feeder, where, bus, phases)
        if (among, bus_index) in taken:
            of_kind = f"{among} " if among else ""
            raise ScenarioError(f"scenario {name!r}: more than one {of_kind}device at bus {bus!r}; give each its own")
        taken.add((among, bus_index))
    free = _least_free(feeder, devices) if isinstance(feeder, RandomFeeders) else len(free_load_buses(feeder, devices))
    if drawn > free:
        where = path_of(next(device for device in devices if device.buses is None))
        raise ScenarioError(
            f"scenario {name!r}: {where}.count is {drawn}, but only {free} load buses have no device; ask for fewer or "
            f"name {where}.buses"
        )
    if not any(device.count for device in devices):
        raise ScenarioError(
            f"scenario {name!r}: no data centre and no inverter, hence no agent; give datacenters.count, "
            "inverters.buses or other devices"
        )


def _least_free(feeders: RandomFeeders, devices: tuple[Any, ...]) -> int:
    """Return the minimum number of load buses without a device over some random feeders."""
    return max(0, feeders.least_loaded - len({bus for device in devices for bus in device.buses or ()}))


def path_of(device: Device) -> str:
    """Return the path prefix of a group of devices in paths of a scenario's fields."""
    return next((path for path, kind in GROUPS.items() if kind == device.kind), device.kind)


def _position(name: str, feeder: AnyFeeder | RandomFeeders, where: str, bus: object, phases: str | None) -> int:
    """Return the position of a device's bus; ScenarioError for one that is not allowed, or lacks these phases."""
    if isinstance(bus, bool) or not isinstance(bus, int | str):
        raise ScenarioError(
            f"scenario {name!r}: {where}.buses has {bus!r}, no number or text; give buses of the feeder"
        )
    try:
        bus_index = feeder.index(bus)
    except FeederError as error:
        raise ScenarioError(f"scenario {name!r}: {error}") from None
    try:
        feeder.nodes_at(bus_index, phases)
    except FeederError as error:
        raise ScenarioError(f"scenario {name!r}: {where}.phases has {phases!r}, but {error}") from None
    if bus_index == 0:
        raise ScenarioError(
            f"scenario {name!r}: a device at the substation {bus!r}, where the source is; choose another bus"
        )
    return bus_index
