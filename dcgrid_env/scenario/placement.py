"""Placement of a scenario's devices: checks of their buses, load buses to draw from, and the ends of a feeder."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.core.checked import FieldError
from dcgrid_env.devices.device import Device
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.devices.phases import phases_of
from dcgrid_env.grid import AnyFeeder, Feeder, FeederError
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.assembly import GROUPS


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


def feeder_ends(feeder: AnyFeeder, allowed: np.ndarray) -> list[int]:
    """Return the positions in ``bus_ids`` of the feeder's ends, starting with those that are farthest apart.

    An end is an allowed bus without an allowed bus behind it. The first end is the electrically farthest from the
    source. Each next end has the most impedance between itself and the paths to the previous ends. The first few ends
    are therefore on different branches rather than side by side at the tip of the longest. This is the long-path
    decomposition of the tree, computed in one pass.

    Parameters
    ----------
    feeder
        Any feeder.
    allowed
        Whether a bus may be chosen, bool, (n_bus,).
    """
    z_pu = branch_impedance(feeder)
    order = feeder.depth_first.order
    length = np.zeros(feeder.n_bus)
    tip = np.full(feeder.n_bus, -1)
    chains: list[tuple[float, int]] = []
    for i in order[::-1].tolist():
        if tip[i] < 0 and allowed[i]:
            tip[i] = i
        if i == 0 or tip[i] < 0:
            continue
        parent = int(feeder.parent[i - 1])
        reach = float(length[i] + z_pu[i - 1])
        if tip[parent] < 0 or reach > length[parent]:
            if tip[parent] >= 0:
                chains.append((length[parent], int(tip[parent])))
            length[parent], tip[parent] = reach, tip[i]
        else:
            chains.append((reach, int(tip[i])))
    if tip[0] > 0:
        chains.append((float(length[0]), int(tip[0])))
    return [end for _, end in sorted(chains, key=lambda chain: (-chain[0], chain[1]))]


def branch_impedance(feeder: AnyFeeder) -> np.ndarray:
    """Magnitude of the series impedance of the branch to each bus but the first, p.u., (n_branch,)."""
    return np.hypot(feeder.r_pu, feeder.x_pu) if isinstance(feeder, Feeder) else feeder.branch_z_pu


def check_placement(feeder: AnyFeeder | RandomFeeders, devices: tuple[Any, ...]) -> None:
    """Raise FieldError unless every device can have a separate bus, not the substation; equipment takes none.

    A group with a class attribute ``shares_bus`` that is True may share buses with devices of other kinds.
    """
    drawn, taken = 0, set[tuple[str, int]]()
    for device in reversed([device for device in devices if not is_equipment(device)]):
        path = path_of(device)
        if device.buses is None:
            drawn += device.count
            continue
        if not isinstance(device.buses, tuple) or len(device.buses) != device.count:
            remedy = f"but {path}.buses is {device.buses!r}; give both, as many buses as the count, or buses alone, or"
            raise FieldError(
                "Scenario", f"{path}.count", ..., f"is {device.count}, {remedy} buses None to have them drawn"
            )
        among = device.kind if getattr(device, "shares_bus", False) else ""
        for bus, phases in zip(device.buses, phases_of(device), strict=True):
            key = among, _position(feeder, path, bus, phases)
            if key in taken:
                remedy = f"has {bus!r}, where another {among or 'device'} is; give each its own bus"
                raise FieldError("Scenario", f"{path}.buses", ..., remedy)
            taken.add(key)
    free = _least_free(feeder, devices) if isinstance(feeder, RandomFeeders) else len(free_load_buses(feeder, devices))
    if drawn > free:
        path = path_of(next(device for device in devices if device.buses is None))
        remedy = f"only {free} load buses have no device; give fewer, or name {path}.buses"
        raise FieldError("Scenario", f"{path}.count", drawn, remedy)
    if not any(device.count for device in devices):
        remedy = "are none, hence there is no agent; give datacenters.count, inverters.buses or other devices"
        raise FieldError("Scenario", "devices", ..., remedy)


def _least_free(feeders: RandomFeeders, devices: tuple[Any, ...]) -> int:
    """Return the minimum number of load buses without a device over some random feeders."""
    return max(0, feeders.least_loaded - len({bus for device in devices for bus in device.buses or ()}))


def path_of(device: Device) -> str:
    """Return the path prefix of a group of devices in paths of a scenario's fields."""
    return next((path for path, kind in GROUPS.items() if kind == device.kind), device.kind)


def _position(feeder: AnyFeeder | RandomFeeders, path: str, bus: object, phases: str | None) -> int:
    """Return the position of a device's bus; FieldError for one that is not allowed, or lacks these phases."""
    if isinstance(bus, bool) or not isinstance(bus, int | str):
        raise FieldError("Scenario", f"{path}.buses", ..., f"has {bus!r}, no number or text; give buses of the feeder")
    try:
        position = feeder.index(bus)
    except FeederError as error:
        raise FieldError("Scenario", f"{path}.buses", ..., f"has {bus!r}: {error}") from None
    try:
        feeder.nodes_at(position, phases)
    except FeederError as error:
        raise FieldError("Scenario", f"{path}.phases", ..., f"has {phases!r}, but {error}") from None
    if position == 0:
        remedy = f"has the substation {bus!r}, where the source is; choose another bus"
        raise FieldError("Scenario", f"{path}.buses", ..., remedy)
    return position
