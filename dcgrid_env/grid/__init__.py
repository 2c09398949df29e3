"""Feeders: the frozen description of a radial network and the named published cases."""

from dcgrid_env.grid.cases import FEEDER_REGISTRY, FEEDERS, load_feeder
from dcgrid_env.grid.feeder import BusId, Feeder, FeederError

__all__ = ["FEEDERS", "FEEDER_REGISTRY", "BusId", "Feeder", "FeederError", "load_feeder"]
