"""Feeders with loops: a bundled feeder with branches added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dcgrid_env import Feeder, load_feeder

TIES = (
    ("21", "8", 2.0, 2.0),
    ("9", "15", 2.0, 2.0),
    ("12", "22", 2.0, 2.0),
    ("18", "33", 0.5, 0.5),
    ("25", "29", 0.5, 0.5),
)
"""Tie lines of ieee33, r and x in ohm. Baran and Wu 1989."""


def with_branches(feeder: Feeder, branches: Sequence[tuple[str, str, float, float]], rating_a: float = 0.0) -> Feeder:
    """A feeder with further branches (from, to, r_ohm, x_ohm), and if given one rating for all branches, A."""
    network = feeder.to_network()
    line = network.line
    columns = (tuple(column) for column in zip(*branches, strict=True))
    from_bus, to_bus, r_ohm, x_ohm = (
        tuple(old) + new for old, new in zip((line.from_bus, line.to_bus, line.r_ohm, line.x_ohm), columns, strict=True)
    )
    rated = (rating_a,) * len(from_bus) if rating_a else ()
    line = replace(line, from_bus=from_bus, to_bus=to_bus, r_ohm=r_ohm, x_ohm=x_ohm, rating_a=rated)
    return Feeder.from_network(replace(network, line=line))


def ieee33_with_ties(n: int, rating_a: float = 0.0) -> Feeder:
    """ieee33 with the first n of its tie lines closed."""
    return with_branches(load_feeder("ieee33"), TIES[:n], rating_a)
