"""Inverters of a scenario: reactive power by command, active power by schedule."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.core.checked import FieldError, is_number, part, refuse, settle
from dcgrid_env.devices.device import Channel, CostTerm, DeviceInput, DeviceState, Field, GridChange, Q
from dcgrid_env.devices.phases import Phases, check_phases
from dcgrid_env.devices.ratings import InverterParams, Rating, check_rating, per_device, read_only
from dcgrid_env.devices.ride_through import connection, riding_inverter
from dcgrid_env.devices.ride_through.rules import RideThrough, UpsRideThrough
from dcgrid_env.grid import buses_as_text
from dcgrid_env.traces import SUN, PowerTrace, TraceError, is_recording, recorded_trace


@dataclass(frozen=True, kw_only=True)
class Inverters(PickledByFields):
    """Inverters that differ only in their ratings. A rating is one number for all of them, or one for each."""

    kind: ClassVar[str] = "inverter"
    prefix: ClassVar[str] = "inv"
    input: ClassVar[str | None] = "injection"
    levels: ClassVar[tuple[str, ...]] = ()
    changes_grid: ClassVar[bool] = False

    buses: tuple[int | str, ...] = ()
    """Buses of the inverters, one each."""
    s_rated_kva: Rating = 0.0
    """Apparent-power rating, kVA."""
    injection: PowerTrace | tuple[float, ...] | str | None = None
    """Active injection of every inverter; none by default.

    "pv": generated PV under passing clouds, a window drawn in each episode, the same for all inverters. A recording
    starts with the episode; 1 kW in it is the inverter's rating. Shares of the rating from -1 to 1, one for t = 0 and
    one for each step, are a schedule, for instance of a storage (negative charges). Plain form: "pv", a list of shares,
    or a recording's name or file.
    """
    phases: Phases | None = None
    """Phases of a three-phase feeder that an inverter feeds in equal parts, such as "abc" or "b"; by default all that
    its bus has."""
    ride_through: RideThrough | None = part(RideThrough, default=None, text="curve")
    """Rule for trips and returns; None for inverters that stay connected at any voltage."""

    def __post_init__(self) -> None:
        settle(self, buses=buses_as_text, injection=_injection)
        if not isinstance(self.buses, tuple):
            raise refuse(self, "buses", "give a tuple of buses, () for none")
        check_rating(self, "s_rated_kva", self.count)
        check_phases(self, self.count)
        if self.ride_through is not None:
            if isinstance(self.ride_through, UpsRideThrough):
                raise refuse(self, "ride_through", "give RideThrough(curve=..), a mapping of its fields, or None")
            self.ride_through.check_slots(self.count)
        if isinstance(self.injection, tuple):
            wrong = [share for share in self.injection if not is_number(share) or not -1 <= share <= 1]
            if wrong:
                problem = f"has {len(self.injection)} shares, {wrong[0]!r} among them"
                remedy = "give numbers from -1 to 1, for t = 0 and each step"
                raise FieldError("Inverters", "injection", ..., f"{problem}; {remedy}")
        elif not (self.injection is None or self.injection == SUN):
            if not isinstance(self.injection, PowerTrace):
                share = "a PowerTrace or a file of one as a share of the rating"
                remedy = f"give {SUN!r}, {share}, shares for each step, or None"
                raise refuse(self, "injection", remedy)
            highest = float(np.max(self.injection.power_kw))
            if highest > 1.0:
                wrong = f"rises to {highest:g}, but it is a share of the inverter's rating"
                remedy = "scale it, for instance trace.scaled_to(1.0)"
                raise FieldError("Inverters", "injection", ..., f"{wrong}; {remedy}")

    @property
    def count(self) -> int:
        """Number of inverters."""
        return len(self.buses)

    @cached_property
    def parameters(self) -> InverterParams:
        """Ratings as arrays over the inverters."""
        return InverterParams(s_rated_kva=read_only(per_device(self.s_rated_kva, self.count)))

    @property
    def q_limit_kvar(self) -> np.ndarray:
        """Reactive limit of each inverter at zero active power, kvar."""
        return self.parameters.s_rated_kva

    @property
    def p_scale_kw(self) -> np.ndarray:
        """Rating that a draw is a share of, kVA."""
        return self.parameters.s_rated_kva

    @property
    def converter_kva(self) -> np.ndarray:
        """Apparent-power rating as an array, kVA."""
        return self.parameters.s_rated_kva

    @property
    def largest_draw_share(self) -> float:
        """Highest draw as a share of the rating, when an inverter charges: 1."""
        return 1.0

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Channels: reactive power only."""
        q = self.q_limit_kvar
        return (Channel(Q, "kvar", -q, q, rest=0.0 * q),)

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Observed fields in addition to those of every agent: the state of the connection, if it may trip."""
        return riding_inverter.fields(self.ride_through, self.count) if self.ride_through else ()

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Cost terms in addition to those of every agent: trips, if inverters can trip."""
        return riding_inverter.cost_terms(self.ride_through, self.count) if self.ride_through else ()

    def initial(self, parameters: InverterParams, zero: Array) -> DeviceState:
        """Return the initial state; an inverter that cannot trip has none."""
        if self.ride_through is None:
            return ()
        return riding_inverter.RidingInverterState(connection.initial(self.ride_through, zero))

    def step(
        self,
        parameters: InverterParams,
        state: DeviceState,
        setpoints: tuple[Array, ...],
        device_input: DeviceInput,
        dt_s: float,
    ) -> tuple[Any, Array]:
        """Inject the scheduled power times the connected share."""
        if self.ride_through is None:
            return (), -device_input
        return riding_inverter.step(self.ride_through, state, device_input, dt_s)

    def connected(self, state: DeviceState) -> Array:
        """Return the share of each inverter's power that is on the grid, see ``device.may_leave``."""
        return state.connection.share

    def grid_change(self, parameters: InverterParams, state: DeviceState) -> GridChange:
        """Change nothing in the grid."""
        return GridChange()

    def observe(self, parameters: InverterParams, state: DeviceState, given_next: Array) -> tuple[Array, ...]:
        """Return the raw figures of ``fields``."""
        return riding_inverter.observe(self.ride_through, state) if self.ride_through else ()

    def amount(self, name: str, parameters: InverterParams, state: DeviceState) -> Array:
        """Return the amount of a cost term; KeyError for a name that is not in ``cost_terms``."""
        if self.ride_through is None or name != "tripped":
            raise KeyError(name)
        return state.connection.tripped

    @property
    def step_totals(self) -> tuple[str, ...]:
        """Names of the totals that count events of a step."""
        return riding_inverter.STEP_TOTALS if self.ride_through else ()

    def totals(self, state: DeviceState) -> dict[str, Array]:
        """Return the trips in the step and the disconnected inverters, if they can trip."""
        return riding_inverter.totals(state) if self.ride_through else {}

    def metrics(self, history: DeviceState, dt_s: float, requests: object) -> dict[str, float]:
        """Return the trips and the disconnected time, if inverters can trip."""
        return riding_inverter.metrics(history, dt_s) if self.ride_through else {}

    def check_episode(self, horizon: int) -> None:
        """Raise FieldError unless a schedule is as long as an episode."""
        if isinstance(self.injection, tuple) and len(self.injection) < horizon + 1:
            remedy = f"give {horizon + 1} numbers from -1 to 1, for t = 0 and each step"
            raise FieldError("Inverters", "injection", ..., f"has {len(self.injection)} shares; {remedy}")


def _injection(value: object) -> Any:
    if not is_recording(value):
        return value
    try:
        return recorded_trace(str(value))
    except (TraceError, OSError) as error:
        raise FieldError("Inverters", "injection", str(value), str(error)) from None
