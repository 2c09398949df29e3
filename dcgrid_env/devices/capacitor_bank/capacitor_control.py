"""Settings of the built-in control of capacitor banks that a scenario chooses.

They apply to banks in mode ``controlled`` that have no row in the table of capacitor controls.

    voltage: on below ``on_below_pu``, off above ``off_above_pu``, the mean of the bank's phases
    kvar: on above ``on_above_share``, off below ``off_below_share``, what the branch brings to the bank's phases of
    its bus, what the bank injects subtracted, as a share of the bank's rating

A threshold must be passed for ``delay_s`` without a break.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dcgrid_env.core.checked import choice, number, refuse, settle
from dcgrid_env.devices.set_points import SHORTEST_HOLD_S


@dataclass(frozen=True, kw_only=True)
class CapacitorControl:
    """Switching rule of a controlled bank.

    The defaults of the reactive control are those of the IEEE 8500 node feeder: of 300 kvar a phase, on above 150 kvar
    and off below -225, after 100 s.
    """

    measures: Literal["voltage", "kvar"] = choice("voltage", "kvar", default="voltage")
    """Quantity that the control uses."""
    on_below_pu: float = number(0.5, 1.5, default=0.98)
    """Voltage below which it is switched on, p.u."""
    off_above_pu: float = number(0.5, 1.5, default=1.04)
    """Voltage above which it is switched off, p.u.; above ``on_below_pu``."""
    on_above_share: float = number(-10.0, 10.0, default=0.5)
    """Reactive power into its bus above which it is switched on, as a share of its rating."""
    off_below_share: float = number(-10.0, 10.0, default=-0.75)
    """Reactive power below which it is switched off; more than 1 below ``on_above_share``, as the bank itself brings
    it down by 1."""
    delay_s: float = number(0.0, 86_400.0, default=100.0)
    """Time for which a threshold is passed before it switches, s."""
    hold_s: float = number(SHORTEST_HOLD_S, 86_400.0, default=60.0)
    """Least time between changes of the thresholds by an agent (mode ``"setpoint"``), s."""

    def __post_init__(self) -> None:
        settle(self)
        if self.off_above_pu <= self.on_below_pu:
            raise refuse(self, "off_above_pu", f"give more than on_below_pu = {self.on_below_pu:g}")
        if self.off_below_share >= self.on_above_share - 1.0:
            highest = self.on_above_share - 1.0
            raise refuse(self, "off_below_share", f"give less than on_above_share - 1 = {highest:g}, or it never rests")
