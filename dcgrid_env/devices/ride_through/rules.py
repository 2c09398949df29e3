"""Rules for disconnection and reconnection: of an inverter, and of a site with a UPS."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from dcgrid_env.core.cache import PickledByFields, cached_on_owner
from dcgrid_env.core.checked import (
    FieldError,
    choice,
    count,
    number,
    refuse,
    settle,
)
from dcgrid_env.devices.ride_through.voltage_curve import Elements, RideThroughCurve, curves_of

ALL_BACK = 1.0 - 1e-6
"""Share above which a device counts as fully reconnected: ten steps of a tenth add up to slightly less than 1."""
LONGEST_S = 1e6
"""Longest time of a rule, s: eleven days."""
Release = Literal["by hand", "staggered", "agent"]


class Figures(NamedTuple):
    """Settings of a rule for each slot, and for all."""

    threshold: np.ndarray
    """Thresholds of the elements, p.u., undervoltages first, (slot, n_element)."""
    time_s: np.ndarray
    """Time that each element counts before it trips, s, (slot, n_element)."""
    delay_s: np.ndarray
    """Delay of each slot before it returns, s, (slot,)."""
    release_s: np.ndarray
    """Delay before a release from a lock-out, s, (slot,)."""
    n_under: int
    """Number of elements for undervoltages."""
    longest_s: float
    """Largest value of the time since the last event, s."""
    remembered_s: float
    """Largest value of the age of an event or a return, s."""
    window_s: float
    """Window of a lock-out, s."""


@dataclass(frozen=True, kw_only=True)
class RideThrough(PickledByFields):
    """Disconnection under voltages that the curve does not ride through, and return with a ramp after a delay.

    For devices without a battery, such as inverters.
    """

    curve: Any
    """Ride-through curve: a name (``voltage_curve``), RideThroughCurve or mapping; or a list, one for each slot."""
    return_delay_s: float = number(0.0, LONGEST_S, default=300.0)
    """Time that the voltage must be within the mildest thresholds before the device returns, s. The default is that
    of IEEE 1547 for entering service."""
    walk_in_s: float = number(0.0, LONGEST_S, default=300.0)
    """Duration of the ramp from zero to full power on return, s; 0 for no ramp."""
    trip_weight: float = number(0.0, 1e9, default=0.0)
    """Weight of the cost term ``trips`` of sites, ``inverter_trips`` of inverters: share that disconnects in a step."""

    lockout_events = 0
    returns_per_minute = 0
    release = "by hand"
    stagger_s = 0.0
    by_hand_s = 0.0
    lockout_window_s = 0.0

    def __post_init__(self) -> None:
        settle(self, curve=curves_of)
        curves = self.curve if isinstance(self.curve, tuple) else (self.curve,)
        if not curves or not all(isinstance(curve, RideThroughCurve) for curve in curves):
            raise refuse(self, "curve", "give the name of a curve, a RideThroughCurve, or a list of one for each slot")

    def check_slots(self, slots: int) -> None:
        """Raise FieldError if there are several curves, but not one for each slot."""
        if isinstance(self.curve, tuple) and len(self.curve) != slots:
            problem = f"has {len(self.curve)} curves"
            raise FieldError(type(self).__name__, "curve", ..., f"{problem}; give one, or one for each of {slots}")

    @cached_on_owner
    def elements(self, slots: int) -> Elements:
        """Return the curves of that many slots."""
        return Elements(self.curve if isinstance(self.curve, tuple) else (self.curve,) * slots)

    @cached_on_owner
    def delays_s(self, slots: int) -> tuple[np.ndarray, np.ndarray]:
        """Return each slot's delay before a return, and before its release from a lock-out, s, (slot,) each."""
        later = self.stagger_s * np.arange(slots) * (self.release == "staggered")
        hand = 0.0 if self.release == "agent" else self.by_hand_s
        return self.return_delay_s + later, np.maximum(hand, self.return_delay_s) + later

    def longest_wait_s(self, slots: int) -> float:
        """Return the cap of the time since the last event, s: no rule looks further back."""
        latest = max(float(times.max(initial=0.0)) for times in self.delays_s(slots))
        return max(latest, self.by_hand_s + self.stagger_s * max(slots - 1, 0))

    @cached_on_owner
    def figures(self, slots: int) -> Figures:
        """Return the rule's settings for that many slots."""
        elements = self.elements(slots)
        return Figures(
            elements.threshold,
            elements.time_s,
            *self.delays_s(slots),
            n_under=elements.n_under,
            longest_s=self.longest_wait_s(slots),
            remembered_s=self.remembered_s,
            window_s=float(self.lockout_window_s),
        )

    @cached_property
    def remembered_s(self) -> float:
        """Return the cap of the age of an event or a return, s."""
        return max(2.0 * self.lockout_window_s, 60.0)


@dataclass(frozen=True, kw_only=True)
class UpsRideThrough(RideThrough):
    """Ride-through of a site with a UPS, which transfers to its battery and may be locked out.

    Events are voltages that the curve does not ride through. Sags count whether the site is connected or away; slow
    events count only while it is connected. Voltages that are ridden through never count. An event transfers a
    connected site to its battery. ``lockout_events`` within the window lock the UPS out: it stays on battery until it
    is released.
    """

    return_delay_s: float = number(0.0, LONGEST_S, default=3.0)
    """Time that the voltage must be normal before a UPS that is not locked out returns, s (manuals: up to 3)."""
    walk_in_s: float = number(0.0, LONGEST_S, default=10.0)
    """Duration of the ramp from battery to grid, s (manuals: 5 to 30); the shortest one if the agent decides."""
    lockout_events: int = count(0, 10, default=3)
    """Number of events within the window that lock it out; 0 for no lock-out. The rule behind 10 July 2024 is three."""
    lockout_window_s: float = number(1.0, LONGEST_S, default=60.0)
    """Window of the lock-out, s."""
    returns_per_minute: int = count(0, 10, default=3)
    """Maximum number of returns that begin within a minute, 0 for no limit (manuals: a fourth is inhibited)."""
    release: Release = choice("by hand", "staggered", "agent", default="by hand")
    """Who decides on the return. "by hand": a site that is locked out is released ``by_hand_s`` after the last event,
    others return by themselves. "staggered": the same, each slot ``stagger_s`` after the one before it. "agent": the
    channel ``return`` sets the time and speed of the return, and the release."""
    by_hand_s: float = number(0.0, LONGEST_S, default=600.0)
    """Time from the last event until a site that is locked out is released by hand, s. The value is a choice: NERC
    reports only a manual release. If the agent decides, this and ``stagger_s`` set the range of ``ups_wait``."""
    stagger_s: float = number(0.0, LONGEST_S, default=30.0)
    """Time between the returns of two slots if they are staggered, s."""
    on_battery: Literal["serves", "waits"] = choice("serves", "waits", default="serves")
    """Whether work continues on battery, or waits while the battery supplies only the idle draw."""
    battery_s: float = number(0.0, LONGEST_S, default=300.0)
    """Energy of the battery, seconds at the site's rating; a site with an empty battery is off, and its work waits."""
    recharge_share: float = number(0.0, 1.0, default=0.1)
    """Highest draw to recharge as a share of the rating, on top of the site's own, both at most the rating."""
    charge_efficiency: float = number(0.01, 1.0, default=0.95)
    """Share of the energy drawn to recharge that is stored."""
    away_weight: float = number(0.0, 1e9, default=0.0)
    """Weight of the cost term ``away``: the share of sites that are away."""
    missing_weight: float = number(0.0, 1e9, default=9.0)
    """Weight of the cost term ``recharge`` at the end of an episode: energy missing in the batteries, as seconds at
    the rating. Energy from the battery is then not free, as leftover work is not."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.release == "agent" and self.walk_in_s <= 0.0:
            raise refuse(self, "walk_in_s", "give more than 0 s where the agent sets how fast a site returns")
