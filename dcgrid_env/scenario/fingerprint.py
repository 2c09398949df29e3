"""The fingerprint of a scenario, so that a published figure can be told to be of the same thing.

What it covers is written down, as schema 1: for each kind of object its name and its fields, in this order, each by
value. A field that is in no list came later; it is left out at its default, so that a new field with a default changes
no fingerprint. What stands here is never changed: another list is another schema, with a number of its own, and
published figures are made anew.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import MISSING
from itertools import chain
from typing import Any, NamedTuple

from dcgrid_env.core.digest import digest
from dcgrid_env.devices import PrefillDecodeDvfs
from dcgrid_env.devices.faults import Fault
from dcgrid_env.grid import Feeder
from dcgrid_env.scenario.scenario import CostWeights, Scenario


class Kind(NamedTuple):
    """What the schema says of a kind of object."""

    name: str
    fields: tuple[str, ...]
    """Always hashed."""
    named: bool = True
    """Whether the names of these fields are hashed too."""


_SCENARIO = """
    name feeder v0_pu capacitors n_datacenters datacenter_buses p_rated_kw idle_share f_min_mhz f_max_mhz s_rated_share
    q_max_share dvfs boost_share inverter_buses inverter_s_kva inverter_trace faults trace recording_split trace_window
    site_correlation compute_share load_sigma load_rho voltage_noise_pu measurement_delay horizon dt_s power_flow split
    weights band_pu voltage_cost reward observe preview r_model_share x_model_share
"""
_FEEDER = "name base_kv v0_pu bus_ids p_load_kw q_load_kvar capacitor_kvar parent r_ohm x_ohm x y"
_WEIGHTS = "voltage violation backlog effort leftover clock step loss"

SCHEMA_1: dict[type[Any], Kind] = {
    Scenario: Kind("Scenario", tuple(_SCENARIO.split())),
    Feeder: Kind("Feeder", tuple(_FEEDER.split())),
    CostWeights: Kind("tuple8", tuple(_WEIGHTS.split()), named=False),
    Fault: Kind("Fault", ("among", "begin_s", "duration_s")),
    PrefillDecodeDvfs: Kind("PhaseDvfs", ("decode_clock_share", "decode_memory_share", "compute_linear_share")),
}


def scenario_hash(scenario: Scenario) -> str:
    """SHA-256 of a scenario by schema 1, 16 hexadecimal digits.

    ValueError for a clock law of one's own whose figures cannot be read.
    """
    return digest([("", scenario)], fields)


def fields(value: Any) -> tuple[str, Iterable[tuple[str, Any]]] | None:
    """What schema 1 hashes of a value; None for a kind of which it says nothing."""
    kind = SCHEMA_1.get(type(value))
    if kind is None:
        return None
    always = ((name if kind.named else "", getattr(value, name)) for name in kind.fields)
    later = {name: default for name, default in _defaults(type(value)).items() if name not in kind.fields}
    changed = ((name, getattr(value, name)) for name, default in later.items() if getattr(value, name) != default)
    return kind.name, chain(always, changed)


def _defaults(kind: type[Any]) -> dict[str, Any]:
    """Fields of a dataclass or named tuple with their defaults."""
    if not dataclasses.is_dataclass(kind):
        return {name: kind._field_defaults.get(name) for name in kind._fields}
    return {
        f.name: f.default if f.default_factory is MISSING else f.default_factory() for f in dataclasses.fields(kind)
    }
