"""Where a scenario's devices may stand: checks of their buses, and the buses that are drawn from."""

from __future__ import annotations

from typing import Any

import numpy as np

from dcgrid_env.grid import Feeder, FeederError
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.flat_names import FLAT


def free_load_buses(feeder: Feeder, devices: tuple[Any, ...]) -> np.ndarray:
    """Positions in ``bus_ids`` where a device may be drawn: load buses without one that stands fixed."""
    taken = {0, *(feeder.index(bus) for device in devices for bus in device.buses or ())}
    free = [i for i in np.flatnonzero(feeder.p_load_kw > 0) if i not in taken]
    return np.array(free, dtype=np.int64)


def check_placement(name: str, feeder: Feeder, devices: tuple[Any, ...]) -> None:
    """Raise ScenarioError unless every device can have a bus of its own, not the substation."""
    fixed: list[tuple[str, Any]] = []
    drawn = 0
    for device in reversed(devices):
        if device.buses is None:
            drawn += device.count
            continue
        count, buses = _words(device)
        if not isinstance(device.buses, tuple) or len(device.buses) != device.count:
            raise ScenarioError(
                f"scenario {name!r}: {count} is {device.count}, but {buses} is {device.buses!r}; give both, "
                f"{count}={device.count} and as many {buses}, or {buses}=None to have them drawn among the load buses"
            )
        where = next((name for name, of in FLAT.items() if of == (device.kind, "buses")), f"{device.kind}.buses")
        fixed += ((where, bus) for bus in device.buses)
    taken: dict[int, Any] = {}
    for where, bus in fixed:
        at = _position(name, feeder, where, bus)
        if at in taken:
            raise ScenarioError(f"scenario {name!r}: more than one device at bus {bus!r}; give each its own")
        taken[at] = bus
    free = len(free_load_buses(feeder, devices))
    if drawn > free:
        count, buses = _words(next(device for device in devices if device.buses is None))
        raise ScenarioError(
            f"scenario {name!r}: {count} is {drawn}, but only {free} load buses have no device; ask for fewer or name "
            f"{buses}"
        )
    if not any(device.count for device in devices):
        raise ScenarioError(
            f"scenario {name!r}: no data centre and no inverter, hence no agent; give n_datacenters, inverter_buses or "
            "other devices"
        )


def _words(device: Any) -> tuple[str, str]:
    """What the number and the buses of a device are called where a scenario is made."""
    return ("n_datacenters", "datacenter_buses") if device.kind == "datacenter" else ("count", "buses")


def _position(name: str, feeder: Feeder, where: str, bus: Any) -> int:
    """Position of a device's bus; ScenarioError for one that no device can have."""
    if isinstance(bus, bool) or not isinstance(bus, int | str):
        raise ScenarioError(f"scenario {name!r}: {where} has {bus!r}, no number or text; give buses of the feeder")
    try:
        at = feeder.index(bus)
    except FeederError as error:
        raise ScenarioError(f"scenario {name!r}: {error}") from None
    if at == 0:
        raise ScenarioError(
            f"scenario {name!r}: a device at the substation {bus!r}, whose voltage is held; choose another bus"
        )
    return at
