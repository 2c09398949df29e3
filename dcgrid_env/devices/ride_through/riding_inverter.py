"""Inverters that trip and return: the part of ``Inverters`` for a ride-through rule."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dcgrid_env.core.arrays import Array, namespace, sum_last
from dcgrid_env.core.metric import Metric, cost_metric
from dcgrid_env.devices.device import CostTerm, Field
from dcgrid_env.devices.ride_through import connection
from dcgrid_env.devices.ride_through.connection import ConnectionState, Supply
from dcgrid_env.devices.ride_through.rules import RideThrough

METRICS = (
    cost_metric("inverter_trips", "inverter trip cost"),
    Metric("inverter_trips", "inverters tripped", "", 1, "lower", "number of times that an inverter left the grid",
        "sum", tables=("run",)),
    Metric("inverter_away_s", "inverter-seconds away", "s", 1, "lower",
        "time of inverters away from the grid, a ramp by its share", "sum"),
)  # fmt: skip
"""Metrics of inverters that may leave the grid."""


class RidingInverterState(NamedTuple):
    """State of inverters that can trip."""

    connection: ConnectionState


def fields(rule: RideThrough, slots: int) -> tuple[Field, ...]:
    """Share on the grid, and the timers of trip and return, as shares of what they run to."""
    one = np.ones(slots)
    return (
        Field("connected", "share of the power on the grid", 0.0, 1.0, one),
        Field("trip_timer", "share of the time to a slow trip", 0.0, 1.0, one),
        Field("return_wait", "share of the delay", 0.0, 1.0, one * max(rule.longest_wait_s(slots), 1e-9)),
    )


def cost_terms(rule: RideThrough, slots: int) -> tuple[CostTerm, ...]:
    """Trips."""
    weight = rule.trip_weight
    return (CostTerm("inverter_trips", "tripped", np.ones(slots), float(max(slots, 1)), 1.0, False, weight, True),)


def step(
    rule: RideThrough, state: RidingInverterState, supply: Supply, dt_s: float
) -> tuple[RidingInverterState, Array]:
    """Inject what the schedule says, as far as it is connected, see ``Device.step``."""
    before = state.connection
    after = connection.advance(rule, before, supply, connection.by_rule(rule, dt_s), dt_s)
    if supply.available is not None:  # what a fault has taken already is not lost again
        after = after._replace(tripped=after.tripped * supply.available)
    after = after._replace(lost_kw=-after.tripped * before.share * supply.device_input)
    return RidingInverterState(after), -after.share * supply.device_input


def observe(rule: RideThrough, state: RidingInverterState) -> tuple[Array, ...]:
    """Raw figures of ``fields``."""
    link = state.connection
    *_, timer_share = connection.counters(rule, link)
    return link.share, timer_share, link.wait_s


STEP_TOTALS = ("inverter_trips",)
"""Names of the totals that count events of a step."""


def totals(state: RidingInverterState) -> dict[str, Array]:
    """Trips in the step, and inverters that are away."""
    link = state.connection
    away = namespace(link.share).astype(link.share <= 0.0, link.share.dtype)
    return {"inverter_trips": sum_last(link.tripped), "inverters_away": sum_last(away)}


def metrics(history: RidingInverterState, dt_s: float) -> dict[str, float]:
    """Figures of an episode, see ``core.metric``."""
    link = history.connection
    return {"inverter_trips": link.tripped[1:].sum(), "inverter_away_s": (1.0 - link.share[1:]).sum() * dt_s}
