"""The fields of a connection study's file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

from dcgrid_env import UpsRideThrough
from dcgrid_env.apps.hosting.sites_together import Rule
from dcgrid_env.core.checked import number, part, refuse, settle

SECTIONS = (
    "base-case", "capacity", "worst-window", "day", "year", "ride-through", "fluctuation", "sensitivity", "checklists",
)  # fmt: skip
"""Sections of the report that can be left out; ``outages`` and ``several-sites`` are computed on request only."""

NOT_STATED = "not stated"
"""Source of limits for which the file names no document."""


@dataclass(frozen=True, kw_only=True)
class FluctuationLimits:
    """Limits of ramps and flicker that the report compares with; None for none."""

    ramp_kw_per_s: float | None = None
    """Largest ramp of the site, kW/s."""
    ramp_window_s: float = number(0.1, 600.0, default=1.0)
    """Window over which a ramp is averaged, s."""
    voltage_step_pct: float = number(0.1, 100.0, default=3.0)
    """Largest voltage change in a step of 0.1 s, % of nominal voltage."""
    pst: float = number(0.01, 100.0, default=1.0)
    """Largest short-term flicker."""
    source: str = NOT_STATED
    """Document that the limits come from."""

    def __post_init__(self) -> None:
        settle(self)
        if self.ramp_kw_per_s is not None and not (
            isinstance(self.ramp_kw_per_s, int | float) and self.ramp_kw_per_s > 0
        ):
            raise refuse(self, "ramp_kw_per_s", "give a ramp > 0 kW/s, or leave it out")
        if not isinstance(self.source, str):
            raise refuse(self, "source", "give the name of a document")


@dataclass(frozen=True, kw_only=True)
class RideThroughTest:
    """Voltage sags that the site experiences."""

    curve: str = "itic"
    """Curve by which the site leaves the grid."""
    sags: str = "virginia-2024"
    """Recorded sequence of sags."""

    def __post_init__(self) -> None:
        settle(self)
        UpsRideThrough(curve=self.curve)  # which refuses a curve that there is not


@dataclass(frozen=True, kw_only=True)
class SeveralSites:
    """Further sites that ask for a connection at the same time."""

    buses: tuple[str, ...]
    """Buses of the further sites."""
    rule: Rule = "equal"
    """``equal`` shares as far as possible, or the largest ``sum``."""

    def __post_init__(self) -> None:
        settle(self, buses=lambda value: [*map(_bus, value)] if isinstance(value, list | tuple) else value)
        if not (isinstance(self.buses, tuple) and self.buses and all(isinstance(bus, str) for bus in self.buses)):
            raise refuse(self, "buses", "give a list of at least one bus, as texts")
        if self.rule not in get_args(Rule):
            raise refuse(self, "rule", f"choose one of {', '.join(get_args(Rule))}")


@dataclass(frozen=True, kw_only=True)
class StudyRequest:
    """A data centre that asks for a connection, and what the report is to contain."""

    bus: str
    """Bus of the connection."""
    mw: float = number(0.001, 1e5)
    """Requested rating, MW."""
    title: str = "Connection study"
    feeder: str | None = None
    """Feeder: a folder or the name of a bundled one."""
    scenario: str | None = None
    """Scenario with the devices that are there already; None for none."""
    controllers: tuple[str, ...] = ("none", "droop")
    """Controllers of the site, the first of which is the one without control."""
    set: dict[str, Any] = field(default_factory=dict)
    """Scenario fields to override."""
    capacity: dict[str, Any] = field(default_factory=dict)
    """Settings of the capacity study, the fields of ``Study``: buses, samples, v_min_pu, .."""
    limits: FluctuationLimits = part(FluctuationLimits)
    ride_through: RideThroughTest = part(RideThroughTest)
    outages: tuple[str, ...] = ()
    """Outages for which the capacity of the bus is found again, as in ``with_outage``, or ``all``; none by default."""
    several_sites: SeveralSites | None = part(SeveralSites, default=None)
    """Further sites, with which the bus shares what the feeder carries; None for none."""
    leave_out: tuple[str, ...] = ()
    """Sections to leave out."""

    def __post_init__(self) -> None:
        settle(self, bus=_bus)
        for name in ("bus", "title"):
            if not isinstance(getattr(self, name), str) or not getattr(self, name).strip():
                raise refuse(self, name, "give a text")
        if self.feeder is None and self.scenario is None:
            raise refuse(self, "feeder", "give a feeder, a scenario, or both")
        for name in ("controllers", "outages", "leave_out"):
            value = getattr(self, name)
            if not isinstance(value, tuple) or not all(isinstance(word, str) for word in value):
                raise refuse(self, name, "give a list of names")
        if not self.controllers:
            raise refuse(self, "controllers", "name at least one controller (dcgrid list)")
        for section in self.leave_out:
            if section not in SECTIONS:
                raise refuse(self, "leave_out", f"its sections are {', '.join(SECTIONS)}")
        if self.several_sites is not None and self.bus in self.several_sites.buses:
            raise refuse(self, "several_sites", f"it names the bus {self.bus} itself; name other buses")
        for name in ("set", "capacity"):
            if not isinstance(getattr(self, name), Mapping):
                raise refuse(self, name, "give a table of fields")


def _bus(value: object) -> object:
    """The name of a bus, also where the file has it as a whole number."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value
