"""A battery behind a converter: a device that exists for the tests alone, to show what a new one takes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace
from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.core.checked import number, settle
from dcgrid_env.devices import Channel, CostTerm, Field, GridChange
from dcgrid_env.devices.ratings import Rating, check_rating, per_device, read_only
from dcgrid_env.grid import buses_as_text


class BatteryParameters(NamedTuple):
    """Figures of the batteries, each (slot,)."""

    p_rated_kw: Array
    energy_kwh: Array
    efficiency: Array
    """Share of the energy that is left after one way, in or out."""


class BatteryState(NamedTuple):
    """State after a step, each (row, slot)."""

    stored_kwh: Array
    charged_kw: Array
    """Draw from the grid, kW; negative where it discharges."""


@dataclass(frozen=True, kw_only=True)
class Batteries(PickledByFields):
    """Batteries that are charged and discharged by a setpoint."""

    kind: ClassVar[str] = "battery"
    prefix: ClassVar[str] = "bat"
    input: ClassVar[str | None] = None
    levels: ClassVar[tuple[str, ...]] = ("stored_kwh",)
    changes_grid: ClassVar[bool] = False

    buses: tuple[int | str, ...]
    p_rated_kw: Rating
    energy_kwh: Rating
    efficiency: float = number(0.1, 1.0, default=0.95)
    cycling_weight: float = number(0.0, 1e6, default=0.0)

    def __post_init__(self) -> None:
        settle(self, buses=buses_as_text)
        check_rating(self, "p_rated_kw", self.count)
        check_rating(self, "energy_kwh", self.count)

    @property
    def count(self) -> int:
        return len(self.buses)

    @cached_property
    def parameters(self) -> BatteryParameters:
        rated, energy = per_device(self.p_rated_kw, self.count), per_device(self.energy_kwh, self.count)
        return BatteryParameters(*map(read_only, (rated, energy, np.full(self.count, self.efficiency))))

    @property
    def p_scale_kw(self) -> np.ndarray:
        return self.parameters.p_rated_kw

    @property
    def converter_kva(self) -> np.ndarray:
        return self.parameters.p_rated_kw

    @property
    def q_limit_kvar(self) -> np.ndarray:
        return np.zeros(self.count)

    @property
    def largest_draw_share(self) -> float:
        return 1.0

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        rated = self.parameters.p_rated_kw
        return (Channel("power", "kW", -rated, rated, rest=0.0 * rated),)

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        return (Field("stored", "share of the energy", 0.0, 1.0, self.parameters.energy_kwh),)

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        rated = self.parameters.p_rated_kw
        return (CostTerm("cycling", "throughput", rated, float(rated.sum()), 1.0, weight=self.cycling_weight),)

    def check_episode(self, horizon: int) -> None:
        pass

    def initial(self, parameters: BatteryParameters, zero: Array) -> BatteryState:
        return BatteryState(zero + 0.5 * parameters.energy_kwh, zero)

    def step(
        self,
        parameters: BatteryParameters,
        state: BatteryState,
        setpoints: tuple[Array, ...],
        device_input: Any,
        dt_s: float,
    ) -> tuple[BatteryState, Array]:
        (asked_kw,) = setpoints
        xp, hours = namespace(asked_kw), dt_s / 3600.0
        room_kw = (parameters.energy_kwh - state.stored_kwh) / (parameters.efficiency * hours)
        left_kw = state.stored_kwh * parameters.efficiency / hours
        p_kw = xp.maximum(xp.minimum(asked_kw, room_kw), -left_kw)
        gained = xp.where(p_kw > 0, p_kw * parameters.efficiency, p_kw / parameters.efficiency)
        return BatteryState(state.stored_kwh + gained * hours, p_kw), p_kw

    def grid_change(self, parameters: BatteryParameters, state: BatteryState) -> GridChange:
        return GridChange()

    def observe(self, parameters: BatteryParameters, state: BatteryState, given_next: Any) -> tuple[Array, ...]:
        return (state.stored_kwh,)

    def amount(self, name: str, parameters: BatteryParameters, state: BatteryState) -> Array:
        return namespace(state.charged_kw).abs(state.charged_kw)

    def totals(self, state: BatteryState) -> dict[str, Array]:
        return {"stored_kwh": state.stored_kwh.sum(-1)}

    def metrics(self, history: BatteryState, dt_s: float, requests: Any) -> dict[str, float]:
        return {"stored_end_kwh": float(history.stored_kwh[-1].sum())}
