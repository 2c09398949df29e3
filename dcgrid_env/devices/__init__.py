"""Devices: parameters, and a pure step each."""

from dcgrid_env.devices.dvfs import Dvfs, LinearDvfs, phases_of, speed_share
from dcgrid_env.devices.params import DataCenterParams, InverterParams
from dcgrid_env.devices.phase_dvfs import PhaseDvfs

__all__ = ["DataCenterParams", "Dvfs", "InverterParams", "LinearDvfs", "PhaseDvfs", "phases_of", "speed_share"]
