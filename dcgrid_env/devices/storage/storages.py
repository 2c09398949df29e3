"""Storages of a scenario: active power by command as far as their energy goes, and reactive power where they have it.

A storage is an agent of its own, with its own converter; it may stand at a bus where another device stands, as a UPS or
the capacitors of a rack do at a data centre's.
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
from dcgrid_env.devices.ratings import Rating, check_rating, per_device, read_only
from dcgrid_env.devices.storage import energy_balance, figures, sizes
from dcgrid_env.devices.storage.energy_balance import StorageParams, StorageState
from dcgrid_env.grid import buses_as_text

P = "p"
"""Name of the channel that is the draw from the grid, kW, negative to discharge."""


@dataclass(frozen=True, kw_only=True)
class Storages(figures.StorageFigures, PickledByFields):
    """Storages alike but for their figures. A figure is one number for all of them, or one for each."""

    kind: ClassVar[str] = "storage"
    prefix: ClassVar[str] = "sto"
    input: ClassVar[str | None] = "connection"
    levels: ClassVar[tuple[str, ...]] = tuple(name for name in StorageState._fields if name != "storage_kw")
    changes_grid: ClassVar[bool] = False
    shares_bus: ClassVar[bool] = True

    buses: tuple[int | str, ...] = ()
    """Their buses, one each, where other devices may stand too."""
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
        """Capacitors in the racks of sites of so many GPUs each, see ``sizes``; other fields as they are given."""
        n = _each("gpus", gpus, buses)
        power = tuple(sizes.GPU_PEAK_SHARE * sizes.GPU_POWER_KW * gpu for gpu in n)
        energy = tuple(sizes.GPU_ENERGY_J / 3.6e6 * gpu for gpu in n)
        return cls(**{"buses": buses, "p_rated_kw": power, "energy_kwh": energy} | sizes.SUPERCAPACITOR | fields)

    @classmethod
    def ups(
        cls, buses: tuple[int | str, ...], p_rated_kw: Rating, minutes: float = sizes.UPS_MINUTES, **fields: Any
    ) -> Storages:
        """Batteries that bear their sites' power for minutes, see ``sizes``; other fields as they are given."""
        (lasting,) = _each("minutes", minutes, ("",))
        return cls._lasting(buses, p_rated_kw, lasting / 60.0, sizes.UPS | fields)

    @classmethod
    def bess(
        cls, buses: tuple[int | str, ...], p_rated_kw: Rating, hours: float = sizes.BESS_HOURS, **fields: Any
    ) -> Storages:
        """Batteries at the grid that give their rated power for hours, see ``sizes``; other fields as given."""
        (lasting,) = _each("hours", hours, ("",))
        return cls._lasting(buses, p_rated_kw, lasting, sizes.BESS | fields)

    @classmethod
    def _lasting(cls, buses: Any, p_rated_kw: Rating, hours: float, fields: dict[str, Any]) -> Storages:
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
        """Apparent-power rating of each converter, kVA; its active power alone where none is given."""
        return read_only(per_device(self.p_rated_kw if self.s_rated_kva is None else self.s_rated_kva, self.count))

    @cached_property
    def q_limit_kvar(self) -> np.ndarray:
        """Reactive limit of each storage at zero active power, kvar."""
        return read_only((0.0 if self.s_rated_kva is None else 1.0) * self.converter_kva)

    @property
    def largest_draw_share(self) -> float:
        """A storage draws its rating at most."""
        return 1.0

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Active power, and reactive power where there is a rating for it."""
        p, q = self.parameters.p_rated_kw, self.q_limit_kvar
        active = Channel(P, "kW", -p, p, rest=0.0 * p)
        return (active,) if self.s_rated_kva is None else (active, Channel(Q, "kvar", -q, q, rest=0.0 * q))

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """State of charge, and how much it can charge and discharge over the coming interval."""
        return figures.fields(self.parameters)

    def cost_terms(self, horizon: int, dt_s: float) -> tuple[CostTerm, ...]:
        """Throughput, and energy that is missing at the end."""
        return figures.cost_terms(self.parameters)

    def check_episode(self, horizon: int) -> None:
        """Nothing of a storage depends on the length of an episode."""

    def initial(self, parameters: StorageParams, zero: Array) -> StorageState:
        """The energy that they begin with."""
        return energy_balance.initial(parameters, zero)

    def step(
        self, parameters: StorageParams, state: StorageState, setpoints: tuple[Array, ...], given: Any, dt_s: float
    ) -> tuple[StorageState, Array]:
        """Charge or discharge as far as there is room or energy, see ``energy_balance``."""
        (asked_kw,) = setpoints
        after = energy_balance.step(parameters, state, asked_kw, given, dt_s)
        return after, after.storage_kw

    def grid_change(self, parameters: StorageParams, state: StorageState) -> GridChange:
        """Leave the grid as it is."""
        return GridChange()

    def observe(self, parameters: StorageParams, state: StorageState, given_next: Any) -> tuple[Array, ...]:
        """Raw figures of the fields, kWh and kW."""
        return state.stored_kwh, state.charge_limit_kw, state.discharge_limit_kw

    def amount(self, name: str, parameters: StorageParams, state: StorageState) -> Array:
        """Throughput, kW, or energy that is missing, kWh, each times its price."""
        return figures.amount(name, parameters, state)

    def totals(self, state: StorageState) -> dict[str, Array]:
        """Energy of all storages that is stored, has been put through, has been lost, and is missing, kWh."""
        return figures.totals(state)

    def metrics(self, history: StorageState, dt_s: float, requests: Any) -> dict[str, float]:
        """Energy at the end and at its lowest, and what was put through, lost and is missing."""
        return figures.metrics(self.parameters, history)


def _each(name: str, value: Any, buses: Any) -> tuple[float, ...]:
    """A positive figure of each storage; FieldError for what is none. Wrong buses are for the group to refuse."""
    n = len(buses) if isinstance(buses, tuple | list) else 1
    values = tuple(value) if isinstance(value, tuple | list) else (value,) * n
    if len(values) != n or not all(finite(v) and v > 0 for v in values):
        raise FieldError(
            "Storages", name, value, "give one positive number" + (f", or one for each of {n}" if n > 1 else "")
        )
    return values
