"""Lines and cables that random feeders are built of: impedance and ampacity of each size, as published."""

from __future__ import annotations

from typing import NamedTuple


class Conductor(NamedTuple):
    """A size of a line or cable."""

    name: str
    r_ohm_per_km: float
    x_ohm_per_km: float
    ampacity_a: float


NA2XS2Y_10_KV = (
    Conductor("NA2XS2Y 1x150 6/10 kV", 0.206, 0.110, 315.0),
    Conductor("NA2XS2Y 1x185 6/10 kV", 0.161, 0.110, 358.0),
    Conductor("NA2XS2Y 1x240 6/10 kV", 0.122, 0.105, 416.0),
    Conductor("NA2XS2Y 1x300 6/10 kV", 0.100, 0.0974, 471.0),
    Conductor("NA2XS2Y 1x400 6/10 kV", 0.078, 0.0942, 535.0),
)
"""Cables of 10 kV: standard types of SimBench and pandapower."""
NA2XS2Y_20_KV = (
    Conductor("NA2XS2Y 1x70 12/20 kV", 0.443, 0.132, 220.0),
    Conductor("NA2XS2Y 1x120 12/20 kV", 0.253, 0.119, 283.0),
    Conductor("NA2XS2Y 1x185 12/20 kV", 0.161, 0.117, 362.0),
    Conductor("NA2XS2Y 1x240 12/20 kV", 0.122, 0.112, 421.0),
)
"""Cables of 20 kV, from the same."""
AL_ST_20_KV = (
    Conductor("34-AL1/6-ST1A 20", 0.8342, 0.382, 170.0),
    Conductor("70-AL1/11-ST1A 20", 0.4132, 0.360, 290.0),
    Conductor("122-AL1/20-ST1A 20", 0.2376, 0.344, 410.0),
    Conductor("184-AL1/30-ST1A 20", 0.1571, 0.330, 535.0),
)
"""Overhead lines of 20 kV, from the same."""
NAYY = (
    Conductor("NAYY 4x50", 0.642, 0.083, 142.0),
    Conductor("NAYY 4x150", 0.2067, 0.0804, 270.0),
    Conductor("NAYY 4x240", 0.1267, 0.0798, 357.0),
)
"""Cables of 0.4 kV, from the same and the Kerber networks."""
ACSR = (
    Conductor("2 6/1 ACSR", 1.050, 0.530, 180.0),
    Conductor("1/0 6/1 ACSR", 0.696, 0.525, 230.0),
    Conductor("4/0 6/1 ACSR", 0.368, 0.479, 340.0),
    Conductor("336.4 26/7 ACSR", 0.190, 0.397, 530.0),
    Conductor("556.5 26/7 ACSR", 0.1155, 0.378, 730.0),
)
"""Overhead lines of North America: resistance, ampacity and geometric mean radius of W. H. Kersting, Distribution
System Modeling and Analysis, appendix A; reactance at 60 Hz for phases 4.69 feet apart on geometric mean, as in
the spacing 500 of the IEEE test feeders."""
