"""Devices: groups of them with parameters, a state and a pure step."""

from dcgrid_env.devices import converter
from dcgrid_env.devices.datacenter import site_work
from dcgrid_env.devices.datacenter.clock_law import Dvfs, LinearDvfs, speed_share, work_classes_of
from dcgrid_env.devices.datacenter.data_centers import DataCenters
from dcgrid_env.devices.datacenter.power_cap import PowerCapDvfs
from dcgrid_env.devices.datacenter.prefill_decode import PrefillDecodeDvfs
from dcgrid_env.devices.device import Channel, CostTerm, Device, Field, GridChange, Q, Work, may_leave
from dcgrid_env.devices.inverter import Inverters
from dcgrid_env.devices.ratings import DataCenterParams, InverterParams
from dcgrid_env.devices.registry import DEVICE_REGISTRY, device_kind, is_known, register_device
from dcgrid_env.devices.storage.energy_balance import StorageParams
from dcgrid_env.devices.storage.storages import Storages

__all__ = [
    "DEVICE_REGISTRY",
    "Channel",
    "CostTerm",
    "DataCenterParams",
    "DataCenters",
    "Device",
    "Dvfs",
    "Field",
    "GridChange",
    "InverterParams",
    "Inverters",
    "LinearDvfs",
    "PowerCapDvfs",
    "PrefillDecodeDvfs",
    "Q",
    "StorageParams",
    "Storages",
    "Work",
    "converter",
    "device_kind",
    "is_known",
    "may_leave",
    "register_device",
    "site_work",
    "speed_share",
    "work_classes_of",
]
