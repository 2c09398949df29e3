"""Devices: parameters, and a pure step each."""

from dcgrid_env.devices.dvfs import Dvfs, LinearDvfs
from dcgrid_env.devices.params import DataCenterParams, InverterParams

__all__ = ["DataCenterParams", "Dvfs", "InverterParams", "LinearDvfs"]
