"""Banks of regulators whose agents choose the set point of the built-in control, which moves the taps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.devices.device import Channel, Field
from dcgrid_env.devices.grid_equipment import GridEquipment
from dcgrid_env.devices.set_points import in_force, observed_age
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.devices.tap_changer.relay import relay_settings
from dcgrid_env.grid import ThreePhaseFeeder

WIDEST_OFFSET_V = 4.0
"""Largest offset that an agent can request in either direction, V on the relay's base of 120 V."""
WIDEST_HALF_BAND_V = 3.0
"""Largest half band that an agent can request, V."""
_SAME_V = 1e-4


class RegulatorSetPointParams(NamedTuple):
    """Settings of the banks, (slot,) each."""

    rest_offset_v: Array
    rest_half_band_v: Array
    hold_s: Array


class RegulatorSetPointState(NamedTuple):
    """Set points of the banks, and what their regulators do under them, (row, slot) each."""

    offset_v: Array
    """Offset in force, V."""
    half_band_v: Array
    """Half band in force, V."""
    setpoint_age_s: Array
    """Time since the last change, s; ``hold_s`` at t = 0."""
    mean_tap: Array
    """Mean tap of the bank, which the engine puts in after each power flow, as it does the following fields."""
    deviation_v: Array
    """Mean of the relay volts less the target in force, V."""
    moved: Array
    """Taps that the bank made in the last step, in either direction."""


@dataclass(frozen=True, kw_only=True)
class RegulatorSetPoints(GridEquipment):
    """The banks of regulators of a feeder whose set points are chosen by agents, an agent for each bank.

    The channels are the offset of the target, and half the band. One half band applies to all regulators of a bank.
    """

    kind: ClassVar[str] = "regulator_setpoint"
    prefix: ClassVar[str] = "regset"
    levels: ClassVar[tuple[str, ...]] = ("offset_v", "half_band_v", "setpoint_age_s", "mean_tap", "deviation_v")

    names: tuple[str, ...]
    """Names of the banks."""
    members: tuple[tuple[int, ...], ...]
    """Rows of each bank's regulators in their table."""
    buses: tuple[str, ...]
    """The bus that each bank feeds, where its agent measures the voltage."""
    phases: tuple[str, ...]
    farthest: tuple[float, ...]
    """Largest tap of each bank in either direction."""
    target_v: tuple[float, ...]
    """Mean target of the table, V."""
    rest_offset_v: tuple[float, ...]
    """Mean offset of each bank's regulators by default, V; a request moves all of them by its difference to this."""
    rest_half_band_v: tuple[float, ...]
    narrowest_v: tuple[float, ...]
    """Half a tap, V: least half band."""
    hold_s: float

    @classmethod
    def of_feeder(
        cls, feeder: ThreePhaseFeeder, rows: tuple[int, ...], control: RegulatorControl
    ) -> RegulatorSetPoints:
        """Return the banks of some rows of a feeder's table of regulators."""
        table, settings = feeder.network.regulator, relay_settings(feeder)
        offset_v = control.offsets_v(table)
        names = tuple(dict.fromkeys(table.bank[row] for row in rows))
        members = tuple(tuple(row for row in rows if table.bank[row] == name) for name in names)
        narrowest = [float(settings.volts_per_tap[row, row].max() / 2.0) for row in map(list, members)]
        ends = np.maximum(np.abs(settings.lowest), np.abs(settings.highest))
        return cls(
            names=names,
            members=members,
            buses=tuple(table.to_bus[of_bank[0]] for of_bank in members),
            phases=tuple("".join(sorted({p for row in of_bank for p in table.phases[row]})) for of_bank in members),
            farthest=tuple(max(float(ends[list(row)].max()), 1.0) for row in members),
            target_v=tuple(float(settings.target_v[list(row)].mean()) for row in members),
            rest_offset_v=tuple(float(offset_v[list(row)].mean()) for row in members),
            rest_half_band_v=tuple(float(settings.half_band_v[list(row)].max()) for row in members),
            narrowest_v=tuple(narrowest),
            hold_s=control.hold_s,
        )

    @cached_property
    def parameters(self) -> RegulatorSetPointParams:
        """Settings as arrays over the agents."""
        rest = np.array(self.rest_offset_v), np.array(self.rest_half_band_v)
        return RegulatorSetPointParams(*rest, np.full(self.count, self.hold_s))

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Return the channels of the requested offset and half band, whose ranges include the defaults."""
        offset, half = self.parameters[:2]
        lowest = np.minimum(-WIDEST_OFFSET_V, offset), np.minimum(self.narrowest_v, half)
        highest = np.maximum(WIDEST_OFFSET_V, offset), np.maximum(WIDEST_HALF_BAND_V, half)
        return (
            Channel("offset", "V", lowest[0], highest[0], rest=offset),
            Channel("half_band", "V", lowest[1], highest[1], rest=half),
        )

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Return the fields for tap, set point in force, time since its change and deviation of the relays.

        The tap is the bank's mean as a share of the farthest one. Offset and half band are shares of the largest that
        can be requested, and the time is a share of ``hold_s``, at most 1. The deviation is that of the bank's mean
        relay volts from the target in force, divided by the table's target. Measurements have neither noise nor delay,
        like those of ``TapChangers``.
        """
        offset, half = self.channels
        largest_v = np.maximum(-offset.lowest, offset.highest)
        return (
            Field("mean_tap", "taps", -1.0, 1.0, np.array(self.farthest)),
            Field("offset", "V", -1.0, 1.0, largest_v),
            Field("half_band", "V", 0.0, 1.0, half.highest),
            Field("since_change", "s", 0.0, 1.0, self.parameters.hold_s),
            Field("mean_relay", "V", -1.0, 1.0, np.array(self.target_v), of_band=True),
        )

    def initial(self, parameters: RegulatorSetPointParams, zero: Array) -> RegulatorSetPointState:
        """Return the default set points; the first change is possible at once."""
        offset_v, half_band_v, age_s = (zero + values for values in parameters)
        return RegulatorSetPointState(offset_v, half_band_v, age_s, zero, zero, zero)

    def step(
        self,
        parameters: RegulatorSetPointParams,
        state: RegulatorSetPointState,
        setpoints: tuple[Array, ...],
        device_input: object,
        dt_s: float,
    ) -> tuple[RegulatorSetPointState, Array]:
        """Take over what is requested where the set point in force is old enough."""
        before = state.offset_v, state.half_band_v
        offset_v, half_band_v, age_s = in_force(
            (setpoints[0], setpoints[1]), before, state.setpoint_age_s, parameters.hold_s, _SAME_V, dt_s
        )
        state = state._replace(offset_v=offset_v, half_band_v=half_band_v, setpoint_age_s=age_s)
        return state, 0.0 * state.moved

    def observe(
        self, parameters: RegulatorSetPointParams, state: RegulatorSetPointState, given_next: object
    ) -> tuple[Array, ...]:
        """Tap, set point, time since its change, and what the relays are off by, see ``fields``."""
        age_s = observed_age(state.setpoint_age_s, parameters.hold_s)
        return state.mean_tap, state.offset_v, state.half_band_v, age_s, state.deviation_v
