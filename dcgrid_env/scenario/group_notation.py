"""Groups of devices in the words of the command line: how many, of what size, and where.

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


class Kind(NamedTuple):
    """A kind of device as its group is written."""

    option: str
    """The name of the option, which errors begin with."""
    units: dict[str, float]
    """Units and how many kW or kVA each is."""
    places: tuple[str, ...]
    """Places that are not buses by name; the first is meant where none is given."""
    example: str


DATA_CENTRES = Kind("datacenters", {"kW": 1.0, "MW": 1000.0}, (DRAWN, ENDS), "3 x 1 MW at ends")
"""Data centres, drawn unless places are given."""
INVERTERS = Kind(
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


def read_group(kind: Kind, text: str) -> tuple[Part, ...]:
    """Return the parts of a group; none for "none".

    Raises
    ------
    ScenarioError
        For invalid words; the message names the option, the words and what to write instead.
    """
    if text.strip().lower() == "none":
        return ()
    parts = tuple(_part(kind, part.strip()) for part in _PLUS.split(text.strip()))
    if DRAWN in (places := [part.place for part in parts]) and set(places) != {DRAWN}:
        raise _refused(
            kind, text, f"has drawn devices beside others at fixed places; give places to all ({ENDS}), or to none"
        )
    if sum(part.count for part in parts) > MOST:
        raise _refused(kind, text, f"asks for {sum(part.count for part in parts)} devices; give at most {MOST}")
    return parts


def _part(kind: Kind, text: str) -> Part:
    found = _PART.fullmatch(text)
    if found is None:
        raise _refused(kind, text, f"is no group; write COUNT x SIZE UNIT and a place, such as '{kind.example}'")
    scale = {unit.lower(): scale for unit, scale in kind.units.items()}.get(found["unit"].lower())
    if scale is None:
        raise _refused(kind, text, f"is in {found['unit']!r}; give {_or(kind.units)}")
    rating, place = scale * float(found["size"]), _place(kind, text, found["place"])
    if not 0.0 < rating < math.inf:
        raise _refused(kind, text, f"has the size {found['size']}; give more than 0")
    named = len(place) if isinstance(place, tuple) else None
    count = int(found["count"]) if found["count"] else named or 1
    if count < 1:
        raise _refused(kind, text, "has the count 0; give at least 1, or none")
    if named is not None and named != count:
        raise _refused(kind, text, f"names {named} bus{'es' * (named != 1)} for {count} devices; name one for each")
    return Part(count, rating, place)


def _place(kind: Kind, text: str, words: str | None) -> str | tuple[str, ...]:
    """A place of the kind's, or buses."""
    if words is None:
        return kind.places[0]
    plain = " ".join(words.lower().split())
    plain = ENDS if plain in ("ends", "at the ends") else plain
    if plain in kind.places:
        return plain
    if plain in (DRAWN, SPREAD):
        raise _refused(kind, text, f"is to be {plain}, which {kind.option} cannot be; write {_or(_forms(kind))}")
    head, _, listed = words.strip().partition(" ")
    buses = tuple(bus.strip() for bus in listed.split(",")) if head.lower() == "at" else ()
    if not buses or not all(buses):
        raise _refused(kind, text, f"has the place {words.strip()!r}; write {_or(_forms(kind))}")
    return buses


def _forms(kind: Kind) -> list[str]:
    return [*kind.places, "at BUS,BUS,.."]


def _or(words: object) -> str:
    *first, last = map(str, words)  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    return f"{', '.join(first)} or {last}" if first else last


def _refused(kind: Kind, text: str, wrong: str) -> ScenarioError:
    return ScenarioError(f"{kind.option}: {text!r} {wrong}")
