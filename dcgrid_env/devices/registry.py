"""Kinds of devices by name, as plain data name them."""

from __future__ import annotations

from typing import Any, TypeVar

from dcgrid_env.devices.datacenter.data_centers import DataCenters
from dcgrid_env.devices.device import Device
from dcgrid_env.devices.inverter import Inverters

DEVICES: dict[str, type[Any]] = {kind.kind: kind for kind in (DataCenters, Inverters)}
"""Classes of devices by their ``kind``."""


_Kind = TypeVar("_Kind", bound=Device)


def register_device(kind: type[_Kind]) -> type[_Kind]:
    """Make a class of devices known by its ``kind``, so that scenario files can name it; may decorate the class.

    ValueError where another class has that name.
    """
    if DEVICES.setdefault(kind.kind, kind) is not kind:
        raise ValueError(f"device kind {kind.kind!r} is that of {DEVICES[kind.kind].__name__}; choose another name")
    return kind
