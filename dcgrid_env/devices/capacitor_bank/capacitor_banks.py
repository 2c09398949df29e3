"""Capacitor banks as agents: each is switched on or off."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, rounded
from dcgrid_env.devices.device import Channel, Field
from dcgrid_env.devices.grid_equipment import GridEquipment
from dcgrid_env.grid import ThreePhaseFeeder


class CapacitorBankParams(NamedTuple):
    """Settings of the banks, (slot,) each."""

    base: Array
    """1 for a bank that is on in the base case, else 0."""


class CapacitorBankState(NamedTuple):
    """Banks that are agents, (row, slot) each."""

    on: Array
    since_s: Array
    """Time since it was last switched, or since t = 0, s."""
    switched: Array
    """1 where it was switched in the last step, else 0."""


@dataclass(frozen=True, kw_only=True)
class CapacitorBanks(GridEquipment):
    """The capacitor banks of a feeder that are agents; the channel ``on`` runs from 0 to 1 and is on above a half."""

    kind: ClassVar[str] = "capacitor_bank"
    prefix: ClassVar[str] = "cap"
    levels: ClassVar[tuple[str, ...]] = ("on", "since_s")

    names: tuple[str, ...]
    """Names in the capacitors' table."""
    rows: tuple[int, ...]
    """Their rows there."""
    buses: tuple[str, ...]
    phases: tuple[str, ...]
    base: tuple[float, ...]
    """Initial state, 1 for on and 0 for off."""

    @classmethod
    def of_feeder(cls, feeder: ThreePhaseFeeder, rows: tuple[int, ...]) -> CapacitorBanks:
        """Return the banks in some rows of a feeder's table."""
        table, legs = feeder.network.capacitor, feeder.capacitor_legs
        phases = []
        for row in rows:
            ends = np.concatenate((legs.node[legs.row == row], legs.other[legs.row == row]))
            numbers = sorted({int(feeder.node_phase[node]) for node in ends if node >= 0})
            phases.append(
                "".join("abc"[number - 1] for number in numbers) or feeder.bus_phases[feeder.index(table.bus[row])]
            )
        base = tuple(float(feeder.base_capacitor_on[row]) for row in rows)
        names, buses = (tuple(column[row] for row in rows) for column in (table.name, table.bus))
        return cls(names=names, rows=rows, buses=buses, phases=tuple(phases), base=base)

    @cached_property
    def parameters(self) -> CapacitorBankParams:
        """Settings as arrays over the agents."""
        return CapacitorBankParams(np.array(self.base))

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Whether it is to be on."""
        return (Channel("on", "", np.zeros(self.count), np.ones(self.count), rest=np.array(self.base)),)

    def fields(self, horizon: int, dt_s: float) -> tuple[Field, ...]:
        """Whether it is on, and the time since it was switched as a share of the episode."""
        return (
            Field("on", "", 0.0, 1.0, np.ones(self.count)),
            Field("since_switching", "s", 0.0, 1.0, np.full(self.count, horizon * dt_s)),
        )

    def initial(self, parameters: CapacitorBankParams, zero: Array) -> CapacitorBankState:
        """Each bank stands as it does in the base case."""
        return CapacitorBankState(zero + parameters.base, zero, zero)

    def step(
        self,
        parameters: CapacitorBankParams,
        state: CapacitorBankState,
        setpoints: tuple[Array, ...],
        device_input: object,
        dt_s: float,
    ) -> tuple[CapacitorBankState, Array]:
        """Switch as asked for."""
        xp, on = namespace(state.on), rounded(setpoints[0])
        switched = xp.abs(on - state.on)
        since_s = xp.where(switched > 0.0, 0.0 * on, state.since_s + dt_s)
        return CapacitorBankState(on, since_s, switched), 0.0 * on

    def observe(
        self, parameters: CapacitorBankParams, state: CapacitorBankState, given_next: object
    ) -> tuple[Array, ...]:
        """Whether it is on, and the time since it was switched, see ``fields``."""
        return state.on, state.since_s
