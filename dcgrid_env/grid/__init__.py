"""Feeders: the frozen description of a radial network and the named published cases."""

from dcgrid_env.grid.cases import FEEDER_REGISTRY, FEEDERS, is_bundled, load_feeder
from dcgrid_env.grid.feeder import Feeder, FeederError
from dcgrid_env.grid.folder import AnyFeeder, read_feeder
from dcgrid_env.grid.network import BusId, Network, bus_numbers, bus_text, buses_as_text
from dcgrid_env.grid.rated_feeder import RatedFeeder, with_ratings
from dcgrid_env.grid.seasonal_ratings import RatingKind
from dcgrid_env.grid.three_phase import ThreePhaseFeeder

__all__ = [
    "FEEDERS",
    "FEEDER_REGISTRY",
    "AnyFeeder",
    "BusId",
    "Feeder",
    "FeederError",
    "Network",
    "RatedFeeder",
    "RatingKind",
    "ThreePhaseFeeder",
    "bus_numbers",
    "bus_text",
    "buses_as_text",
    "is_bundled",
    "load_feeder",
    "read_feeder",
    "with_ratings",
]
