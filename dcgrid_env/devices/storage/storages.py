"""Storages of a scenario: active power by command within the limits of their energy, and optional reactive power.

A storage is a separate agent with its own converter. It may share a bus with another device, as a UPS or the capacitors
of a rack do at a data centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.cache import PickledByFields
from dcgrid_env.core.checked import FieldError, finite, refuse, settle
from dcgrid_env.devices.device import Channel, CostTerm, Field, GridChange, Q
from dcgrid_env.devices.phases import Phases, check_phases
from dcgrid_env.devices.ratings import LARGEST_RATING, SMALLEST_RATING, Rating, check_rating, per_device, read_only
from dcgrid_env.devices.storage import energy_balance, figures, sizes
from dcgrid_env.devices.storage.energy_balance import StorageParams, StorageState
from dcgrid_env.grid import buses_as_text

P = "p"
"""Name of the channel that is the draw from the grid, kW, negative to discharge."""


@dataclass(frozen=True, kw_only=True)
class Storages(figures.StorageFigures, PickledByFields):
    """Storages that differ only in their figures. A figure is one number for all of them, or one for each."""

    kind: ClassVar[str] = "storage"
    prefix: ClassVar[str] = "sto"
    input: ClassVar[str | None] = "connection"
    levels: ClassVar[tuple[str, ...]] = tuple(name for name in StorageState._fields if name != "storage_kw")
    changes_grid: ClassVar[bool] = False
    shares_bus: ClassVar[bool] = True

    buses: tuple[int | str, ...] = ()
    """Buses of the storages, one each; other devices may use the same bus."""
    s_rated_kva: Rating | None = None
    """Apparent-power rating of the converter, kVA, at least ``p_rated_kw``; None: no reactive power."""
    phases: Phases | None = None
    """Phases of a three-phase feeder that a storage is connected to in equal parts, such as "abc" or "b"; by default
    all that its bus has."""

    def __post_init__(self) -> None:
        settle(self, buses=buses_as_text)
        if not isinstance(self.buses, tuple):
            raise refuse(self, "buses", "give a tuple of buses, () for none")
        self.check_figures(self.count)
        if self.s_rated_kva is not None:
            check_rating(self, "s_rated_kva", self.count)
            if np.any(per_device(self.s_rated_kva, self.count) < per_device(self.p_rated_kw, self.count)):
                raise refuse(self, "s_rated_kva", f"give at least p_rated_kw = {self.p_rated_kw!r}, or None")
        check_phases(self, self.count)

    @classmethod
    def supercapacitors(cls, buses: tuple[int | str, ...], gpus: float | tuple[float, ...], **fields: Any) -> Storages:
        """Make capacitors in the racks of sites with that many GPUs each, see ``sizes``; other fields as given."""
        n = _each("gpus", gpus, buses)
        power = tuple(sizes.GPU_PEAK_SHARE * sizes.GPU_POWER_KW * gpu for gpu in n)
        energy = tuple(sizes.GPU_ENERGY_J / 3.6e6 * gpu for gpu in n)
        return cls(**{"buses": buses, "p_rated_kw": power, "energy_kwh": energy} | sizes.SUPERCAPACITOR | fields)

    @classmethod
    def ups(
        cls, buses: tuple[int | str, ...], p_rated_kw: Rating, minutes: float = sizes.UPS_MINUTES, **fields: Any
    ) -> Storages:
        """Make batteries that supply their sites' power for minutes, see ``sizes``; other fields as given."""
        (lasting,) = _each("minutes", minutes, ("",))
        return cls._lasting(buses, p_rated_kw, lasting / 60.0, sizes.UPS | fields)

    @classmethod
    def bess(
        cls, buses: tuple[int | str, ...], p_rated_kw: Rating, hours: float = sizes.BESS_HOURS, **fields: Any
    ) -> Storages:
        """Make batteries at the grid that supply their rated power for hours, see ``sizes``; other fields as given."""
        (lasting,) = _each("hours", hours, ("",))
        return cls._lasting(buses, p_rated_kw, lasting, sizes.BESS | fields)

    @classmethod
    def _lasting(
        cls, buses: tuple[int | str, ...], p_rated_kw: Rating, hours: float, fields: dict[str, Any]
    ) -> Storages:
        energy = tuple(hours * p_kw for p_kw in _each("p_rated_kw", p_rated_kw, buses))
        return cls(**{"buses": buses, "p_rated_kw": p_rated_kw, "energy_kwh": energy} | fields)

    @property
    def count(self) -> int:
        """Number of storages."""
        return len(self.buses)

    @cached_property
    def parameters(self) -> StorageParams:
        """Figures as arrays over the storages."""
        return self.figures_of(self.count)

    @property
    def p_scale_kw(self) -> np.ndarray:
        """Rating that a draw is a share of, kW."""
        return self.parameters.p_rated_kw

    @cached_property
    def converter_kva(self) -> np.ndarray:
        """Apparent-power rating of each converter, kVA; the rated active power if none is given."""
        return read_only(per_device(self.p_rated_kw if self.s_rated_kva is None else self.s_rated_kva, self.count))

    @cached_property
    def q_limit_kvar(self) -> np.ndarray:
        """Reactive limit of each storage at zero active power, kvar."""
        return read_only((0.0 if self.s_rated_kva is None else 1.0) * self.converter_kva)

    @property
    def largest_draw_share(self) -> float:
        """Highest draw as a share of the rating: 1."""
        return 1.0

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Channels: active power, and reactive power if there is a rating for it."""
        p, q = self.parameters.p_rated_kw, self.q_limit_kvar
        active = Channel(P, "kW", -p, p, rest=0.0 * p)
        return (active,) if self.s_rated_kva is None else (active, Channel(Q, "kvar", -q, q, rest=0.0 * q))

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Observed fields: state of charge, and possible charge and discharge over the coming interval."""
        return figures.fields(self.parameters)

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Cost terms: throughput, and energy that is missing at the end."""
        return figures.cost_terms(self.parameters)

    def check_episode(self, horizon: int) -> None:
        """Accept any number of steps: a storage does not depend on the length of an episode."""

    def initial(self, parameters: StorageParams, zero: Array) -> StorageState:
        """Return the initial state with the initial energy."""
        return energy_balance.initial(parameters, zero)

    def step(
        self,
        parameters: StorageParams,
        state: StorageState,
        setpoints: tuple[Array, ...],
        device_input: object,
        dt_s: float,
    ) -> tuple[StorageState, Array]:
        """Charge or discharge within the free capacity or stored energy, see ``energy_balance``."""
        (asked_kw,) = setpoints
        after = energy_balance.step(parameters, state, asked_kw, device_input, dt_s)
        return after, after.storage_kw

    def grid_change(self, parameters: StorageParams, state: StorageState) -> GridChange:
        """Change nothing in the grid."""
        return GridChange()

    def observe(self, parameters: StorageParams, state: StorageState, given_next: object) -> tuple[Array, ...]:
        """Return the raw figures of the fields, kWh and kW."""
        return state.stored_kwh, state.charge_limit_kw, state.discharge_limit_kw

    def amount(self, name: str, parameters: StorageParams, state: StorageState) -> Array:
        """Return the throughput, kW, or the missing energy, kWh, each times its price."""
        return figures.amount(name, parameters, state)

    def totals(self, state: StorageState) -> dict[str, Array]:
        """Return the stored energy, throughput, losses and missing energy of all storages, kWh."""
        return figures.totals(state)

    def metrics(self, history: StorageState, dt_s: float, requests: object) -> dict[str, float]:
        """Return the energy at the end, its minimum, the throughput, the losses and the missing energy."""
        return figures.metrics(self.parameters, history)


def _each(name: str, value: Any, buses: tuple[int | str, ...]) -> tuple[float, ...]:
    """Return a positive figure for each storage; FieldError otherwise. The group checks the buses."""
    n = len(buses) if isinstance(buses, tuple | list) else 1
    values = tuple(value) if isinstance(value, tuple | list) else (value,) * n
    if len(values) != n or not all(finite(v, SMALLEST_RATING, LARGEST_RATING) for v in values):
        raise FieldError(
            "Storages", name, value, "give one positive number" + (f", or one for each of {n}" if n > 1 else "")
        )
    return values
