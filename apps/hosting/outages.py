"""Feeders with one element out of service or with switches in other positions (N-1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

from dcgrid_env import Scenario, ThreePhaseFeeder
from dcgrid_env.grid import FeederError

ALL = "all"
"""Each capacitor bank that is on, and each bank of regulators."""


def outage_names(scenario: Scenario) -> tuple[str, ...]:
    """Names of the single outages of a scenario's feeder: capacitor banks that are on, and banks of regulators."""
    feeder = scenario.feeder
    if not isinstance(feeder, ThreePhaseFeeder):
        return ()
    banks, states = feeder.network.capacitor.name, feeder.network.capacitor.state
    on = [f"capacitor {name}" for name, state in zip(banks, states, strict=True) if state == "on"]
    return (*on, *(f"regulator {bank}" for bank in dict.fromkeys(feeder.network.regulator.bank)))


def with_outage(scenario: Scenario, outage: str) -> Scenario:
    """A scenario on its feeder with an outage.

    Parameters
    ----------
    scenario
        The scenario.
    outage
        ``capacitor NAME`` (off, without control), ``regulator BANK`` (at its neutral taps, without control), ``open
        NAME`` or ``close NAME`` of a switch; several at once joined by ``+``.

    Raises
    ------
    ValueError
        For an unknown outage or element, or a feeder that has no supply for its loads then; the message names both.
    """
    network: Any = getattr(scenario.feeder, "network", None)
    if not isinstance(scenario.feeder, ThreePhaseFeeder):
        raise ValueError(f"outages: the balanced feeder {scenario.feeder.name!r} has no elements for {outage!r}")
    modes: dict[str, Any] = {name: getattr(scenario.grid_control, name) for name in ("regulators", "capacitors")}
    for part in outage.split("+"):
        word, _, name = part.strip().partition(" ")
        network = _changed(network, word, name.strip(), outage)
        if isinstance(by_bank := modes.get(f"{word}s"), tuple):
            modes[f"{word}s"] = tuple((bank, mode) for bank, mode in by_bank if bank != name.strip())
    if not isinstance(modes["regulators"], tuple) and not any(network.regulator.max_taps_per_move):
        modes["regulators"] = "controlled"  # which moves no fixed tap
    if not isinstance(modes["capacitors"], tuple) and all(network.capacitor.is_fixed or (0,)):
        modes["capacitors"] = "fixed"
    try:
        feeder = ThreePhaseFeeder.from_network(network)
        return scenario.replace(feeder=feeder, grid_control=modes)
    except FeederError as error:
        raise ValueError(f"outages: {outage!r} leaves a feeder that cannot be solved: {error}") from None


def outages_asked(scenario: Scenario, listed: Sequence[str]) -> dict[str, Scenario]:
    """The scenarios with the outages of a list, ``all`` for each of ``outage_names``; ValueError as above."""
    names = list(_named(scenario, listed))
    if listed and not names:
        name = scenario.feeder.name
        raise ValueError(f"outages: feeder {name!r} has no capacitor bank in service and no regulators; remove {ALL!r}")
    return {name: with_outage(scenario, name) for name in dict.fromkeys(names)}


def _named(scenario: Scenario, listed: Sequence[str]) -> Iterator[str]:
    for name in listed:
        if name == ALL:
            yield from outage_names(scenario)
        else:
            yield name


def _changed(network: Any, word: str, name: str, outage: str) -> Any:
    if word == "capacitor":
        return _put(network, "capacitor", "name", name, outage, state="off", is_fixed=1)
    if word == "regulator":
        table = network.regulator
        rows = {"tap": table.tap_neutral, "max_taps_per_move": (0,) * len(table)}
        return _put(network, "regulator", "bank", name, outage, **rows)
    if word in ("open", "close"):
        return _put(network, "switch", "name", name, outage, state="open" if word == "open" else "closed")
    raise ValueError(f"outages: must be capacitor, regulator, open or close with a name, got {outage!r}")


def _put(network: Any, kind: str, key: str, name: str, outage: str, **columns: Any) -> Any:
    """The network with columns of the rows of a name changed; a tuple has a value for each row."""
    table = getattr(network, kind)
    there = getattr(table, key)
    if name not in there:
        known = ", ".join(dict.fromkeys(there)) or "none"
        raise ValueError(f"outages: feeder {network.name!r} has no {kind} {name!r}, got {outage!r}; there are {known}")
    changed = {}
    for column, value in columns.items():
        values = value if isinstance(value, tuple) else (value,) * len(there)
        before = getattr(table, column) or (0,) * len(there)
        pairs = zip(there, before, values, strict=True)
        changed[column] = tuple(new if row_name == name else old for row_name, old, new in pairs)
    return dataclasses.replace(network, **{kind: dataclasses.replace(table, **changed)})
