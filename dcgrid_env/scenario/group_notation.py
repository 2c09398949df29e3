"""Notation for groups of devices on the command line: how many, of what size, and where.

    3 x 1 MW                        three of 1 MW, where the group's rule puts them
    1 MW at 18,33,25                one at each of these buses
    3 x 1 MW at ends                at the ends of the feeder, see ``feeder_ends``
    2 x 500 kW at ends + 1 x 2 MW at 18     parts of different sizes, each with its own places
    3 x 1 MW drawn                  drawn among the load buses in each episode (data centres)
    5 x 200 kvar spread             spread evenly over the load buses (inverters)
    none                            no device of the kind

Units are kW and MW for data centres, whose rating is active power, and kvar, Mvar, kVA and MVA for inverters, whose
reactive limit at zero active power is their apparent-power rating. Case is ignored.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import NamedTuple

from dcgrid_env.scenario.errors import ScenarioError

ENDS, DRAWN, SPREAD = "at ends", "drawn", "spread"
"""Places that are not buses by name."""
MOST = 10_000
"""Maximum number of devices in a group."""
_NUMBER = r"\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?"
_HEAD = rf"(?:(?P<count>\d+)\s*[x×*]\s*)?(?P<size>{_NUMBER})\s*(?P<unit>[A-Za-z]+)"
_PART = re.compile(rf"{_HEAD}(?:\s+(?P<place>.+))?", re.DOTALL)
_PLUS = re.compile(rf"\s*\+\s*(?={re.sub('[?]P<[a-z]+>', '?:', _HEAD)}(?:\s|[+]|$))")


class Notation(NamedTuple):
    """Notation of the groups of one kind of device."""

    option: str
    """Name of the option, which errors begin with."""
    units: dict[str, float]
    """Size of each unit in kW or kVA."""
    places: tuple[str, ...]
    """Places that are not buses by name; the first is the default."""
    example: str

    @property
    def forms(self) -> str:
        """The forms of a place, for messages."""
        return f"{', '.join(self.places)} or at BUS,BUS,.."

    def refused(self, text: str, wrong: str) -> ScenarioError:
        """Return the error of a text."""
        return ScenarioError(f"{self.option}: {text!r} {wrong}")


DATA_CENTRES = Notation("datacenters", {"kW": 1.0, "MW": 1000.0}, (DRAWN, ENDS), "3 x 1 MW at ends")
"""Data centres, drawn unless places are given."""
INVERTERS = Notation(
    "inverters", {"kvar": 1.0, "Mvar": 1000.0, "kVA": 1.0, "MVA": 1000.0}, (SPREAD, ENDS), "5 x 200 kvar at ends"
)
"""Inverters, spread over the load buses unless places are given."""


@dataclass(frozen=True)
class Part:
    """Devices of one size."""

    count: int
    rating: float
    """Rating of each, kW or kVA."""
    place: str | tuple[str, ...]
    """Named place of the kind, or the buses."""


def read_group(kind: Notation, text: str) -> tuple[Part, ...]:
    """Return the parts of a group; none for "none".

    Raises
    ------
    ScenarioError
        For an invalid text; the message names the option, the text and what to write instead.
    """
    if text.strip().lower() == "none":
        return ()
    parts = tuple(_part(kind, part.strip()) for part in _PLUS.split(text.strip()))
    if 0 < sum(part.place == DRAWN for part in parts) < len(parts):
        remedy = f"has drawn devices and others at fixed places; give places to all ({ENDS}), or to none"
        raise kind.refused(text, remedy)
    if (total := sum(part.count for part in parts)) > MOST:
        raise kind.refused(text, f"asks for {total} devices; give at most {MOST}")
    return parts


def _part(kind: Notation, text: str) -> Part:
    match = _PART.fullmatch(text)
    if match is None:
        raise kind.refused(text, f"is no group; write COUNT x SIZE UNIT and a place, such as '{kind.example}'")
    scale = {unit.lower(): scale for unit, scale in kind.units.items()}.get(match["unit"].lower())
    if scale is None:
        *first, last = kind.units
        raise kind.refused(text, f"is in {match['unit']!r}; give {', '.join(first)} or {last}")
    rating, place = scale * float(match["size"]), _place(kind, text, match["place"])
    if not 0.0 < rating < math.inf:
        raise kind.refused(text, f"has the size {match['size']}; give more than 0")
    n_buses = len(place) if isinstance(place, tuple) else None
    count = int(match["count"] or n_buses or 1)
    if count < 1:
        raise kind.refused(text, "has the count 0; give at least 1, or none")
    if n_buses not in (None, count):
        raise kind.refused(text, f"names {n_buses} bus{'es' * (n_buses != 1)} for {count} devices; name one for each")
    return Part(count, rating, place)


def _place(kind: Notation, text: str, words: str | None) -> str | tuple[str, ...]:
    """Return a named place of the kind, or buses."""
    if words is None:
        return kind.places[0]
    name = " ".join(words.lower().split())
    name = ENDS if name in ("ends", "at the ends") else name
    if name in kind.places:
        return name
    if name in (DRAWN, SPREAD):
        raise kind.refused(text, f"is to be {name}, which {kind.option} cannot be; write {kind.forms}")
    head, _, listed = words.strip().partition(" ")
    buses = tuple(bus.strip() for bus in listed.split(","))
    if head.lower() != "at" or not all(buses):
        raise kind.refused(text, f"has the place {words.strip()!r}; write {kind.forms}")
    return buses
