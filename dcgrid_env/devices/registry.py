"""Kinds of devices by name, as plain data name them."""

from __future__ import annotations

from typing import Any, TypeVar

from dcgrid_env.devices.datacenter.data_centers import DataCenters
from dcgrid_env.devices.device import Device
from dcgrid_env.devices.inverter import Inverters

DEVICES: dict[str, type[Any]] = {kind.kind: kind for kind in (DataCenters, Inverters)}
"""Classes of devices by their ``kind``."""


INPUTS = ("workload", "injection", None)
"""What may drive a device from outside."""
RESERVED = ("capacitor", "workload", "background", "sensing", "cost")
"""Names that faults and parts of a scenario have."""
_MEMBERS = tuple(name for name in (*Device.__annotations__, *vars(Device)) if not name.startswith("_"))
_Kind = TypeVar("_Kind", bound=Device)


def register_device(kind: type[_Kind]) -> type[_Kind]:
    """Make a class of devices known by its ``kind``, so that scenario files can name it; may decorate the class.

    ValueError where another class has that name, or the class lacks something of ``device.Device``.
    """
    lacking = [name for name in _MEMBERS if not hasattr(kind, name) and name not in _fields_of(kind)]
    if lacking:
        raise ValueError(f"device {kind.__name__} has no {', '.join(lacking)}; see dcgrid_env/devices/device.py")
    if kind.input not in INPUTS:
        raise ValueError(f"device {kind.__name__}: input is {kind.input!r}; choose one of {INPUTS}")
    if kind.kind in RESERVED:
        raise ValueError(
            f"device {kind.__name__}: kind is {kind.kind!r}, which means something else; choose another name"
        )
    if DEVICES.setdefault(kind.kind, kind) is not kind:
        raise ValueError(f"device kind {kind.kind!r} is that of {DEVICES[kind.kind].__name__}; choose another name")
    return kind


def _fields_of(kind: type[Any]) -> tuple[str, ...]:
    return tuple(getattr(kind, "__dataclass_fields__", ()))
