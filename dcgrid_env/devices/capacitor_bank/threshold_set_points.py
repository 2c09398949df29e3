"""Capacitor banks whose agents choose the thresholds of the built-in voltage control, which switches the banks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.devices.capacitor_bank.capacitor_banks import CapacitorBanks
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.device import Channel, Field
from dcgrid_env.devices.grid_equipment import GridEquipment
from dcgrid_env.devices.set_points import in_force, observed_age
from dcgrid_env.grid import ThreePhaseFeeder

LOWEST_CENTRE_PU, HIGHEST_CENTRE_PU = 0.95, 1.05
"""Range of the centre between the two thresholds, p.u."""
NARROWEST_HALF_PU, WIDEST_HALF_PU = 0.01, 0.05
"""Range of half the distance between the two thresholds, p.u."""
_SAME_PU = 1e-6


class ThresholdParams(NamedTuple):
    """Settings of the banks, (slot,) each."""

    rest_centre_pu: Array
    rest_half_width_pu: Array
    hold_s: Array
    base: Array
    """1 for a bank that is on in the base case, else 0."""


class ThresholdState(NamedTuple):
    """Thresholds of the banks, and what the banks do under them, (row, slot) each."""

    centre_pu: Array
    """Centre between the thresholds in force, p.u."""
    half_width_pu: Array
    """Half the distance between them, p.u."""
    setpoint_age_s: Array
    """Time since the last change, s; ``hold_s`` at t = 0."""
    bank_on: Array
    """1 for a bank that is on, else 0, which the engine puts in after each power flow, as it does the following
    fields."""
    deviation_pu: Array
    """Mean voltage of the bank's phases less the centre in force, p.u."""
    switched: Array
    """Switchings of the bank in the last step."""


@dataclass(frozen=True, kw_only=True)
class ThresholdSetPoints(GridEquipment):
    """The capacitor banks of a feeder whose thresholds are chosen by agents, an agent for each bank.

    A bank is switched on below centre - half width, and off above centre + half width.
    """

    kind: ClassVar[str] = "capacitor_setpoint"
    prefix: ClassVar[str] = "capset"
    levels: ClassVar[tuple[str, ...]] = ("centre_pu", "half_width_pu", "setpoint_age_s", "bank_on", "deviation_pu")

    names: tuple[str, ...]
    """Names in the capacitors' table."""
    members: tuple[tuple[int, ...], ...]
    """The row of each bank there."""
    buses: tuple[str, ...]
    phases: tuple[str, ...]
    base: tuple[float, ...]
    """Initial state, 1 for on and 0 for off."""
    rest_centre_pu: float
    rest_half_width_pu: float
    hold_s: float

    @classmethod
    def of_feeder(
        cls, feeder: ThreePhaseFeeder, rows: tuple[int, ...], control: CapacitorControl
    ) -> ThresholdSetPoints:
        """Return the banks in some rows of a feeder's table of capacitors."""
        banks = CapacitorBanks.of_feeder(feeder, rows)
        low, high = control.on_below_pu, control.off_above_pu
        return cls(
            names=banks.names,
            members=tuple((row,) for row in rows),
            buses=banks.buses,
            phases=banks.phases,
            base=banks.base,
            rest_centre_pu=0.5 * (low + high),
            rest_half_width_pu=0.5 * (high - low),
            hold_s=control.hold_s,
        )

    @cached_property
    def parameters(self) -> ThresholdParams:
        """Settings as arrays over the agents."""
        rest_centre_pu, rest_half_width_pu, hold_s = (
            np.full(self.count, value) for value in (self.rest_centre_pu, self.rest_half_width_pu, self.hold_s)
        )
        return ThresholdParams(rest_centre_pu, rest_half_width_pu, hold_s, np.array(self.base))

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Return the channels of the requested thresholds, whose ranges include the defaults."""
        centre, half = self.parameters[:2]
        lowest = np.minimum(LOWEST_CENTRE_PU, centre), np.minimum(NARROWEST_HALF_PU, half)
        highest = np.maximum(HIGHEST_CENTRE_PU, centre), np.maximum(WIDEST_HALF_PU, half)
        return (
            Channel("centre", "p.u.", lowest[0], highest[0], rest=centre),
            Channel("half_width", "p.u.", lowest[1], highest[1], rest=half),
        )

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Return the fields for the switch, the thresholds in force, the time since their change and the voltage.

        The centre is a deviation from 1 p.u., the half width a share of the largest that can be requested, and the
        time a share of ``hold_s``, at most 1. The voltage is the bank's measurement less the centre.
        """
        one = np.ones(self.count)
        return (
            Field("on", "", 0.0, 1.0, one),
            Field("centre", "p.u.", -1.0, 1.0, one, of_band=True),
            Field("half_width", "p.u.", 0.0, 1.0, self.channels[1].highest),
            Field("since_change", "s", 0.0, 1.0, self.parameters.hold_s),
            Field("bank_voltage", "p.u.", -1.0, 1.0, one, of_band=True),
        )

    def initial(self, parameters: ThresholdParams, zero: Array) -> ThresholdState:
        """Return the default thresholds and the banks of the base case; the first change is possible at once."""
        centre_pu, half_width_pu, age_s, on = (zero + values for values in parameters)
        return ThresholdState(centre_pu, half_width_pu, age_s, on, zero, zero)

    def step(
        self,
        parameters: ThresholdParams,
        state: ThresholdState,
        setpoints: tuple[Array, ...],
        device_input: object,
        dt_s: float,
    ) -> tuple[ThresholdState, Array]:
        """Take over what is requested where the thresholds in force are old enough."""
        before = state.centre_pu, state.half_width_pu
        centre_pu, half_width_pu, age_s = in_force(
            (setpoints[0], setpoints[1]), before, state.setpoint_age_s, parameters.hold_s, _SAME_PU, dt_s
        )
        state = state._replace(centre_pu=centre_pu, half_width_pu=half_width_pu, setpoint_age_s=age_s)
        return state, 0.0 * state.switched

    def observe(self, parameters: ThresholdParams, state: ThresholdState, given_next: object) -> tuple[Array, ...]:
        """Switch, thresholds, time since their change, and voltage, see ``fields``."""
        age_s = observed_age(state.setpoint_age_s, parameters.hold_s)
        return state.bank_on, state.centre_pu - 1.0, state.half_width_pu, age_s, state.deviation_pu
