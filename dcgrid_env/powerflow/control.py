"""Changes of devices to the grid itself, in addition to the power that they draw or inject."""

from __future__ import annotations

from typing import NamedTuple

from dcgrid_env.core.arrays import Array


class Control(NamedTuple):
    """Settings of the grid during one power flow; None where no device sets them.

    Leading dimensions are those of the loads, or none where all rows have the same setting.
    """

    tap_ratio: Array | None = None
    """Voltage ratio of each regulator, shape (..., n_regulator), 1 in the neutral position: see
    ``ThreePhaseFeeder.tap_ratio``. None leaves the base taps of a three-phase feeder."""
    shunt_kvar: Array | None = None
    """Reactive injection of switched shunts by node, kvar, shape (..., n_node), whatever the voltage."""
    capacitor_on: Array | None = None
    """Share of each of a three-phase feeder's capacitor banks that is on, from 0 to 1, shape (..., n_capacitor). None
    leaves their base states."""
