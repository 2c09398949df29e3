"""Regulators as agents: each sets the tap that it would have, and its drive goes there one tap after the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, rounded
from dcgrid_env.devices.device import Channel, Field
from dcgrid_env.devices.grid_equipment import GridEquipment
from dcgrid_env.grid import ThreePhaseFeeder

_SHORTEST_S = 1e-3
_ROUNDING = 1e-9  # of a tap


class TapChangerParams(NamedTuple):
    """Settings of the regulators, (slot,) each."""

    base: Array
    tap_delay_s: Array
    """Time that the drive needs for a tap, s."""
    target_v: Array
    """Volts that the relay is to hold."""


class TapChangerState(NamedTuple):
    """Regulators that are agents, (row, slot) each."""

    tap: Array
    since_s: Array
    """Time since the last tap, s; at t = 0 a drive is ready."""
    moved: Array
    """Taps made in the last step, in either direction."""
    relay_v: Array
    """Relay volts as last measured, which the engine puts in after each power flow."""


@dataclass(frozen=True, kw_only=True)
class TapChangers(GridEquipment):
    """The regulators of a feeder that are agents, an agent for each tap.

    The channel ``tap`` is the tap that is asked for, rounded to a whole one. The drive makes a tap in the
    ``tap_delay_s`` of the regulators' table, whoever commands it: in a step of dt_s the tap goes that far at most.
    """

    kind: ClassVar[str] = "tap_changer"
    prefix: ClassVar[str] = "reg"
    levels: ClassVar[tuple[str, ...]] = ("tap", "since_s", "relay_v")

    names: tuple[str, ...]
    """Names in the regulators' table."""
    rows: tuple[int, ...]
    """Their rows there."""
    buses: tuple[str, ...]
    """The buses that they feed, where their agents measure the voltage."""
    phases: tuple[str, ...]
    base: tuple[float, ...]
    """Initial tap."""
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    tap_delay_s: tuple[float, ...]
    target_v: tuple[float, ...]

    @classmethod
    def of_feeder(cls, feeder: ThreePhaseFeeder, rows: tuple[int, ...]) -> TapChangers:
        """Return the regulators in some rows of a feeder's table."""
        table = feeder.network.regulator

        def numbers(column: Any) -> tuple[float, ...]:
            return tuple(float(column[row]) for row in rows)

        return cls(
            names=tuple(table.name[row] for row in rows),
            rows=rows,
            buses=tuple(table.to_bus[row] for row in rows),
            phases=tuple(table.phases[row] for row in rows),
            base=numbers(table.tap),
            lowest=numbers(table.tap_min),
            highest=numbers(table.tap_max),
            tap_delay_s=numbers(table.tap_delay_s),
            target_v=numbers(table.vreg_v),
        )

    @cached_property
    def parameters(self) -> TapChangerParams:
        """Settings as arrays over the agents."""
        delay_s = np.maximum(np.array(self.tap_delay_s), _SHORTEST_S)
        return TapChangerParams(np.array(self.base), delay_s, np.array(self.target_v))

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Return the channel of the requested tap."""
        return (Channel("tap", "taps", np.array(self.lowest), np.array(self.highest), rest=np.array(self.base)),)

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Return the fields for tap, time since the last move and deviation of the relay from its target.

        The tap is a share of the farthest one, and the time a share of the episode. The deviation is the relay's
        measurement, with line-drop compensation, divided by the target, minus 1. The relay is at the regulator itself.
        Its measurement therefore has neither the noise nor the delay of remote measurements.
        """
        farthest = np.maximum(np.maximum(np.abs(self.lowest), np.abs(self.highest)), 1.0)
        return (
            Field("tap", "taps", -1.0, 1.0, farthest),
            Field("since_tap", "s", 0.0, 1.0, np.full(self.count, horizon * dt_s)),
            Field("relay", "V", -1.0, 1.0, np.array(self.target_v), of_band=True),
        )

    def initial(self, parameters: TapChangerParams, zero: Array) -> TapChangerState:
        """At the base tap, with the drive ready, and the relay at its target until it has measured."""
        delay_s, target_v = zero + parameters.tap_delay_s, zero + parameters.target_v
        return TapChangerState(zero + parameters.base, delay_s, zero, target_v)

    def step(
        self,
        parameters: TapChangerParams,
        state: TapChangerState,
        setpoints: tuple[Array, ...],
        device_input: object,
        dt_s: float,
    ) -> tuple[TapChangerState, Array]:
        """Go towards the tap that is asked for, as far as the drive does in ``dt_s``."""
        xp, delay_s = namespace(state.tap), parameters.tap_delay_s
        ready_s = xp.minimum(state.since_s, delay_s + 0.0 * state.since_s) + dt_s
        most = xp.floor(ready_s / delay_s + _ROUNDING)
        tap = xp.minimum(xp.maximum(rounded(setpoints[0]), state.tap - most), state.tap + most)
        moved = xp.abs(tap - state.tap)
        since_s = xp.where(moved > 0.0, ready_s - moved * delay_s, state.since_s + dt_s)
        return TapChangerState(tap, since_s, moved, state.relay_v), 0.0 * tap

    def observe(self, parameters: TapChangerParams, state: TapChangerState, given_next: object) -> tuple[Array, ...]:
        """Tap, time since the last move, and what the relay is off by, see ``fields``."""
        return state.tap, state.since_s, state.relay_v - parameters.target_v
