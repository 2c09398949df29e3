"""Energy balance of storages over one interval: charge, discharge and losses.

    kept   = E (1 - s)^h                                 h: the interval in hours, s: standby loss as a share an hour
    c      = min(asked, p_rated, (E_max - kept) / (eta_c h))      charge, kW, where power is asked for
    d      = min(-asked, p_rated, kept eta_d / h)                 discharge, kW, where it is to be given
    E'     = kept + (eta_c c - d / eta_d) h

Powers are those at the grid. A storage that is disconnected neither charges nor discharges, and has the same standby
losses.
"""

from __future__ import annotations

from typing import NamedTuple

from dcgrid_env.core.arrays import Array
from dcgrid_env.core.formula import PerSlot, formula, least, most, positive


class StorageParams(NamedTuple):
    """Figures of the storages, (slot,) each."""

    p_rated_kw: Array
    """Largest charge and discharge, kW."""
    energy_kwh: Array
    """Usable energy, kWh."""
    charge_efficiency: Array
    discharge_efficiency: Array
    standby_share_per_h: Array
    """Share of the stored energy that is lost in an hour."""
    initial_kwh: Array
    """Stored energy before t = 0, kWh."""
    returned_kwh: Array
    """Stored energy at the end of an episode, below which it is missing, kWh."""
    ageing_price: Array
    missing_price: Array


class StorageState(NamedTuple):
    """State of the storages after a step, (row, slot) each; losses and throughput are counted from t = 0."""

    stored_kwh: Array
    storage_kw: Array
    """Draw from the grid over the step, kW, negative where it discharges."""
    charge_limit_kw: Array
    """Largest charge over the coming interval, kW."""
    discharge_limit_kw: Array
    """Largest discharge over the coming interval, kW."""
    throughput_kwh: Array
    """Energy charged and energy discharged, at the grid, kWh."""
    storage_loss_kwh: Array
    """Energy drawn from the grid that was neither returned nor stored, and stand-by losses, kWh."""
    missing_kwh: Array
    """Shortfall of the stored energy below the energy required at the end, kWh."""


def initial(params: StorageParams, zero: Array) -> StorageState:
    """State before t = 0; ``zero`` is 0, (row, slot)."""
    stored = zero + params.initial_kwh
    missing = positive(params.returned_kwh - stored)
    return StorageState(stored, zero, zero, zero, zero, zero, missing)


def step(
    params: StorageParams, state: StorageState, asked_kw: Array, connected: Array | None, dt_s: float
) -> StorageState:
    """Advance the storages by one interval.

    Parameters
    ----------
    params, state
        Figures, and the state at the beginning.
    asked_kw
        Setpoint of the draw, kW, negative to discharge, (row, slot).
    connected
        1 for a storage that is connected to the grid and 0 for one that is not, (row, slot); None where all are.
    dt_s
        Length of the interval, s.
    """
    p, s, hours = params, state, dt_s / 3600.0
    share = (1.0 - params.standby_share_per_h) ** hours
    return StorageState(
        *_after(
            p.p_rated_kw, p.energy_kwh, p.charge_efficiency, p.discharge_efficiency, p.returned_kwh, share,
            s.stored_kwh, s.charge_limit_kw, s.discharge_limit_kw, s.throughput_kwh, s.storage_loss_kwh, asked_kw,
            connected, hours,
        )
    )  # fmt: skip


@formula(like="stored_before_kwh", views=("asked_kw", "connected"))
def _after(
    p_rated_kw: PerSlot,
    energy_kwh: PerSlot,
    charge_efficiency: PerSlot,
    discharge_efficiency: PerSlot,
    returned_kwh: PerSlot,
    share: PerSlot,
    stored_before_kwh: Array,
    charge_limit_kw: Array,
    discharge_limit_kw: Array,
    throughput_kwh: Array,
    loss_kwh: Array,
    asked_kw: Array,
    connected: Array | None,
    hours: float,
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
    """The fields of ``StorageState`` after an interval; ``share`` is that of the energy that is kept."""
    p_kw = most(least(asked_kw, charge_limit_kw), -discharge_limit_kw)
    if connected is not None:
        p_kw = p_kw * connected
    charged, discharged = positive(p_kw), positive(-p_kw)
    gained = charged * charge_efficiency - discharged / discharge_efficiency
    # The bounds take off no more than the rounding of a storage that has just run full or empty.
    stored = least(positive(stored_before_kwh * share + gained * hours), energy_kwh)
    kept = stored * share
    room_kw = (energy_kwh - kept) / (charge_efficiency * hours)
    return (
        stored,
        p_kw,
        least(p_rated_kw, room_kw),
        least(p_rated_kw, kept * discharge_efficiency / hours),
        throughput_kwh + (charged + discharged) * hours,
        loss_kwh + p_kw * hours - (stored - stored_before_kwh),
        positive(returned_kwh - stored),
    )
