"""Kinds of devices by their name in plain data: bundled, registered, and from other packages."""

from __future__ import annotations

from typing import Any, TypeVar

from dcgrid_env.core.plugins import Entry, PluginError, Registry
from dcgrid_env.devices.datacenter.data_centers import DataCenters
from dcgrid_env.devices.device import Device
from dcgrid_env.devices.inverter import Inverters
from dcgrid_env.devices.storage.storages import Storages

ENTRIES: dict[str, Entry] = {
    DataCenters.kind: ("work that waits or is served as the clock allows, and reactive power", DataCenters),
    Inverters.kind: ("reactive power by command, active power by schedule", Inverters),
    Storages.kind: ("active power by command as far as its energy goes, and reactive power", Storages),
}
"""What a kind is, in a few words, and its class: this package's own, and what ``register_device`` adds."""
DEVICE_REGISTRY = Registry("dcgrid.devices", "kind of device", Device, ENTRIES)
"""All named kinds of devices, including those of other packages."""

INPUTS = ("workload", "injection", "connection", None)
"""Exogenous inputs that a device may have."""
RESERVED = (
    "capacitor", "workload", "background", "sensing", "cost", "grid_control", "tap_changer", "capacitor_bank",
    "regulator_setpoint", "capacitor_setpoint",
)  # fmt: skip
"""Names that faults, parts of a scenario and equipment of a feeder have."""
_MEMBERS = tuple(name for name in (*Device.__annotations__, *vars(Device)) if not name.startswith("_"))
_Kind = TypeVar("_Kind", bound=Device)


def register_device(kind: type[_Kind]) -> type[_Kind]:
    """Register a class of devices by its ``kind`` for use in scenario files; may decorate the class.

    ValueError where another class has that name, or the class lacks something of ``device.Device``.
    """
    _require_device(kind)
    known = ENTRIES.setdefault(kind.kind, ((kind.__doc__ or kind.__name__).partition("\n")[0], kind))[1]
    if known is not kind:
        raise ValueError(f"device kind {kind.kind!r} is that of {known.__name__}; choose another name")
    return kind


def device_kind(name: str) -> type[Any]:
    """Return the class of devices of a kind, also from another package's entry point ``dcgrid.devices``.

    Raises KeyError for an unknown kind, and PluginError if the entry point does not give a class of such devices.
    """
    kind: Any = DEVICE_REGISTRY[name][1]
    if (origin := DEVICE_REGISTRY.origin(name)) is not None:
        try:
            _require_device(kind)
            if kind.kind != name:
                raise ValueError(f"its kind is {kind.kind!r}")
        except (ValueError, AttributeError) as error:
            raise PluginError(f"kind of device {name!r} of {origin} cannot be used: {error}; mend it") from None
    return kind


def is_known(kind: type[Any]) -> bool:
    """Whether plain data can name a class of devices."""
    name = getattr(kind, "kind", None)
    return isinstance(name, str) and name in DEVICE_REGISTRY and DEVICE_REGISTRY[name][1] is kind


def _require_device(kind: type[Any]) -> None:
    """Raise ValueError for a value that is not a class of devices, or whose name is already used."""
    if not isinstance(kind, type):
        raise ValueError(f"{kind!r} is no class; give a class of devices")
    lacking = [name for name in _MEMBERS if not hasattr(kind, name) and name not in _fields_of(kind)]
    if lacking:
        raise ValueError(f"device {kind.__name__} has no {', '.join(lacking)}; see dcgrid_env/devices/device.py")
    if kind.input not in INPUTS:
        raise ValueError(f"device {kind.__name__}: input is {kind.input!r}; choose one of {INPUTS}")
    if kind.kind in RESERVED:
        raise ValueError(
            f"device {kind.__name__}: kind is {kind.kind!r}, which means something else; choose another name"
        )


def _fields_of(kind: type[Any]) -> tuple[str, ...]:
    return tuple(getattr(kind, "__dataclass_fields__", ()))
