"""Feeders: the frozen description of a radial network and the named published cases."""

from dcgrid_env.grid.cases import FEEDERS, load_feeder
from dcgrid_env.grid.feeder import BusId, Feeder, FeederError

__all__ = ["FEEDERS", "BusId", "Feeder", "FeederError", "load_feeder"]
