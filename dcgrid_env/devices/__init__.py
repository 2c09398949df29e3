"""Devices: parameters, and a pure step each."""

from dcgrid_env.devices.datacenter.clock_law import Dvfs, LinearDvfs, speed_share, work_classes_of
from dcgrid_env.devices.datacenter.prefill_decode import PrefillDecodeDvfs
from dcgrid_env.devices.ratings import DataCenterParams, InverterParams

__all__ = [
    "DataCenterParams",
    "Dvfs",
    "InverterParams",
    "LinearDvfs",
    "PrefillDecodeDvfs",
    "speed_share",
    "work_classes_of",
]
