"""A feeder with other switches open and closed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from dcgrid_env.grid.feeder import Feeder
from dcgrid_env.grid.network import BusId, LineTable
from dcgrid_env.grid.topology import FeederError

Open = tuple[BusId, BusId]
"""Branch to open: its two buses, in either order."""
Closed = tuple[BusId, BusId, float, float]
"""Tie to close: its two buses, resistance and reactance, ohm."""


def reconfigured(feeder: Feeder, opened: Iterable[Open], closed: Iterable[Closed]) -> Feeder:
    """Return a feeder of the same buses after some branches are opened and some ties closed.

    Parameters
    ----------
    feeder
        Balanced feeder of one voltage level.
    opened, closed
        Branches to open and ties to close. The rating of a tie is unknown.

    Returns
    -------
    Feeder
        With the same buses and loads. The order of the buses may differ, because it follows the branches.

    Raises
    ------
    FeederError
        For an unknown bus or branch, a branch that is named twice, or a feeder with transformers of other ratios. Also
        for a result that has an island or loops that the power flow refuses.
    """
    if feeder.voltage_ratio is not None:
        raise FeederError(
            f"feeder {feeder.name!r} has transformers with other ratios, between which a tie has no reference voltage; "
            "give a feeder of one voltage level"
        )
    network = replace(feeder, seasonal_ratings=None).to_network()
    line = network.line
    pairs = [frozenset(pair) for pair in zip(line.from_bus, line.to_bus, strict=True)]
    without: set[int] = set()
    for a, b in opened:
        first = _known(feeder, a)
        pair = frozenset((first, _known(feeder, b)))
        if pair not in pairs:
            there = ", ".join("-".join(sorted(known, key=feeder.index)) for known in pairs if first in known)
            raise FeederError(f"feeder {feeder.name!r} has no branch {a}-{b} to open; at bus {a} are {there}")
        if pairs.index(pair) in without:
            raise FeederError(f"feeder {feeder.name!r}: branch {a}-{b} is opened twice; name it once")
        without.add(pairs.index(pair))
    rating_a = list(line.rating_a) or [float("nan")] * len(pairs)
    rows = [
        (line.from_bus[k], line.to_bus[k], line.r_ohm[k], line.x_ohm[k], rating_a[k])
        for k in range(len(pairs))
        if k not in without
    ]
    rows += [(_known(feeder, a), _known(feeder, b), r_ohm, x_ohm, float("nan")) for a, b, r_ohm, x_ohm in closed]
    from_bus, to_bus, r_ohm, x_ohm, ratings = zip(*rows, strict=True)
    lines = LineTable(from_bus, to_bus, r_ohm, x_ohm, ratings if len(line.rating_a) else ())
    return Feeder.from_network(replace(network, line=lines))


def _known(feeder: Feeder, bus: BusId) -> str:
    """Name of a bus of the feeder; FeederError for an unknown one."""
    return feeder.bus_ids[feeder.index(bus)]
