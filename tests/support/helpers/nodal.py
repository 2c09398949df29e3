"""Radial feeders that are solved by nodal equations."""

from dataclasses import replace

from dcgrid_env import ThreePhaseFeeder
from dcgrid_env.grid.network import AdmittanceTable


def as_nodal(feeder):
    """The feeder with an admittance of a femtosiemens at the end of its first line, which makes it not radial."""
    line = feeder.network.phase_line
    node = f"{line.to_bus[0]}.{line.phases[0][0]}"
    table = AdmittanceTable(("nothing",), ("reactor",), (node,), ((1e-15,),), ((0.0,),))
    return ThreePhaseFeeder.from_network(replace(feeder.network, admittance=table))
