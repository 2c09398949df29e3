"""What the formats of balanced grids have in common: buses and branches in per unit, and how a radial feeder comes
of them."""

from dcgrid_env.apps.importers.bus_branch.described import BalancedFeeder, described
from dcgrid_env.apps.importers.bus_branch.description import Branch, BusBranchGrid, ClosedSwitch, Source
from dcgrid_env.apps.importers.bus_branch.imported import ImportedFeeder, imported
from dcgrid_env.apps.importers.bus_branch.reduction import Reduced, reduced_network

__all__ = [
    "BalancedFeeder",
    "Branch",
    "BusBranchGrid",
    "ClosedSwitch",
    "ImportedFeeder",
    "Reduced",
    "Source",
    "described",
    "imported",
    "reduced_network",
]
