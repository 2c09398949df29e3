"""Devices: parameters, and a pure step each."""

from dcgrid_env.devices.dvfs import Dvfs, LinearDvfs, speed_share, work_classes_of
from dcgrid_env.devices.params import DataCenterParams, InverterParams
from dcgrid_env.devices.prefill_decode import PrefillDecodeDvfs

__all__ = [
    "DataCenterParams",
    "Dvfs",
    "InverterParams",
    "LinearDvfs",
    "PrefillDecodeDvfs",
    "speed_share",
    "work_classes_of",
]
