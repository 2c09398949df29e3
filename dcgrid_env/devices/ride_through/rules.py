"""When a device leaves the grid and how it comes back: the rule of an inverter, and that of a site with a UPS."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from dcgrid_env.core.cache import PickledByFields, cached_on_owner
from dcgrid_env.core.checked import (
    FieldError,
    changed_fields,
    check_fields,
    choice,
    count,
    from_mapping,
    number,
    refuse,
    settle,
)
from dcgrid_env.devices.ride_through.voltage_curve import Elements, RideThroughCurve, curves_of, plain_curve

ALL_BACK = 1.0 - 1e-6
"""A share beyond which a device is back as a whole: ten steps of a tenth add up to a little less than 1."""
LONGEST_S = 1e6
"""Longest time of a rule, s: eleven days."""
Release = Literal["by hand", "staggered", "agent"]


class Figures(NamedTuple):
    """What a rule says of each slot, and of all."""

    threshold: Any
    """Thresholds of the elements, p.u., undervoltages first, (slot, n_element)."""
    time_s: Any
    """How long each element counts before it trips, s, (slot, n_element)."""
    delay_s: Any
    """Delay of each slot before it returns, s, (slot,)."""
    release_s: Any
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
    """A device that disconnects under what its curve does not ride through, and returns after a delay with a ramp.

    Without a battery, as an inverter has it.
    """

    curve: Any
    """A curve by its name (``voltage_curve``), a RideThroughCurve, a mapping of one, or a list, one for each slot."""
    return_delay_s: float = number(0.0, LONGEST_S, default=300.0)
    """How long the voltage must have been ridden through for good before the device returns, s. The default is that of
    IEEE 1547 for entering service."""
    walk_in_s: float = number(0.0, LONGEST_S, default=300.0)
    """How long the ramp from nothing to all takes when it returns, s; 0 is at once."""
    trip_weight: float = number(0.0, 1e9, default=0.0)
    """Weight of the cost term ``trips`` of sites, ``inverter_trips`` of inverters: the share that leaves in a step."""

    lockout_events = 0
    returns_per_minute = 0
    release = "by hand"
    stagger_s = 0.0
    by_hand_s = 0.0
    lockout_window_s = 0.0

    def __post_init__(self) -> None:
        settle(self, curve=curves_of)
        check_fields(self)
        curves = self.curve if isinstance(self.curve, tuple) else (self.curve,)
        if not curves or not all(isinstance(curve, RideThroughCurve) for curve in curves):
            raise refuse(self, "curve", "give the name of a curve, a RideThroughCurve, or a list of one for each slot")

    def check_slots(self, slots: int) -> None:
        """Raise FieldError where there are several curves, and not as many as slots."""
        if isinstance(self.curve, tuple) and len(self.curve) != slots:
            given = f"has {len(self.curve)} curves"
            raise FieldError(type(self).__name__, "curve", ..., f"{given}; give one, or one for each of {slots}")

    @cached_on_owner
    def elements(self, slots: int) -> Elements:
        """The curves of as many slots."""
        return Elements(self.curve if isinstance(self.curve, tuple) else (self.curve,) * slots)

    @cached_on_owner
    def delays_s(self, slots: int) -> tuple[np.ndarray, np.ndarray]:
        """How long each slot waits before it returns, and before it is released from a lock-out, s, (slot,) each."""
        later = self.stagger_s * np.arange(slots) * (self.release == "staggered")
        hand = 0.0 if self.release == "agent" else self.by_hand_s
        return self.return_delay_s + later, np.maximum(hand, self.return_delay_s) + later

    def longest_wait_s(self, slots: int) -> float:
        """What a time since the last event is cut at, s: no rule looks further back."""
        latest = max(float(times.max(initial=0.0)) for times in self.delays_s(slots))
        return max(latest, self.by_hand_s + self.stagger_s * max(slots - 1, 0))

    @cached_on_owner
    def figures(self, slots: int) -> Figures:
        """All that the rule says of as many slots."""
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
        """What the age of an event or a return is cut at, s."""
        return max(2.0 * self.lockout_window_s, 60.0)


@dataclass(frozen=True, kw_only=True)
class UpsRideThrough(RideThrough):
    """A site behind a UPS: it goes over to its battery, and may be locked out there.

    Events are voltages that the curve does not ride through: sags whether the site is connected or away, slow ones
    while it is connected alone. Those that are ridden through are never counted. An event transfers a connected site to
    its battery. So many within the window lock the UPS out: it stays on battery until it is released.
    """

    return_delay_s: float = number(0.0, LONGEST_S, default=3.0)
    """How long the voltage must have been in order before a UPS that is not locked out returns, s (manuals: to 3)."""
    walk_in_s: float = number(0.0, LONGEST_S, default=10.0)
    """How long the ramp from battery to grid takes, s (manuals: 5 to 30); the fastest where the agent decides."""
    lockout_events: int = count(0, 10, default=3)
    """How many events within the window lock it out; 0 for no lock-out. The rule behind 10 July 2024 is three."""
    lockout_window_s: float = number(1.0, LONGEST_S, default=60.0)
    """The window, s."""
    returns_per_minute: int = count(0, 10, default=3)
    """How many returns may begin within a minute, 0 for no limit (manuals: a fourth is inhibited)."""
    release: Release = choice("by hand", "staggered", "agent", default="by hand")
    """Who decides over the return. "by hand": a site that is locked out is released ``by_hand_s`` after the last event,
    others return by themselves. "staggered": the same, each slot ``stagger_s`` after that before it. "agent": the
    channel ``return`` says when and how fast, and releases."""
    by_hand_s: float = number(0.0, LONGEST_S, default=600.0)
    """How long after the last event someone releases a site that is locked out, s. A choice: NERC says by hand. Where
    the agent decides, this and ``stagger_s`` say how far ``ups_wait`` is observed."""
    stagger_s: float = number(0.0, LONGEST_S, default=30.0)
    """How far apart slots return where they are staggered, s."""
    on_battery: Literal["serves", "waits"] = choice("serves", "waits", default="serves")
    """Whether work goes on on battery, or waits while the battery carries the idle draw alone."""
    battery_s: float = number(0.0, LONGEST_S, default=300.0)
    """Energy of the battery as seconds at the site's rating; a site whose battery is empty is dark, its work waits."""
    recharge_share: float = number(0.0, 1.0, default=0.1)
    """Highest draw to recharge as a share of the rating, on top of the site's own, both at most the rating."""
    charge_efficiency: float = number(0.01, 1.0, default=0.95)
    """What is stored of what is drawn to recharge."""
    away_weight: float = number(0.0, 1e9, default=0.0)
    """Weight of the cost term ``away``: the share of sites that are away."""
    missing_weight: float = number(0.0, 1e9, default=9.0)
    """Weight of the cost term ``recharge`` at the end: seconds at the rating that are missing in the batteries, as
    leftover work is charged, so that what the battery gave is not free."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.release == "agent" and self.walk_in_s <= 0.0:
            raise refuse(self, "walk_in_s", "give more than 0 s where the agent sets how fast a site returns")


def rule_of(kind: type[Any], value: Any) -> Any:
    """A rule out of its plain form, a mapping of its fields or the name of a curve; other values as they are.

    FieldError for a field that there is not, or no curve.
    """
    if isinstance(value, str):
        return kind(curve=value)
    return from_mapping(kind, value)


def plain_rule(rule: RideThrough) -> dict[str, Any]:
    """The plain form of a rule: a mapping of its fields, those at their default left out."""
    curve = rule.curve
    plain = {"curve": list(map(plain_curve, curve)) if isinstance(curve, tuple) else plain_curve(curve)}
    return changed_fields(rule) | plain
