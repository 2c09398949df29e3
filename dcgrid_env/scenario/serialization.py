"""Scenarios as plain data, for JSON, YAML, TOML and ``gymnasium.EnvSpec.to_json``.

A part, a group of devices (with its ``kind``) or settings of one are a mapping of their fields, tuples are lists, and
pairs of names and values are a mapping. These fields have another form:

| field | plain form |
|---|---|
| feeder | a feeder's name (bundled, or of another package), the path of a folder, or a mapping for RandomFeeders |
| file and classes of ``load_profiles`` | the path of a file; for classes also a mapping |
| trace | a generator's name, a recording's name or file, or a list of recordings |
| injection | "pv", a list of shares, or a recording's name or file |
| sags | the name of a recorded sequence, or a list of mappings |
| ride_through | a curve's name, or a mapping of the rule's fields |
| clock_law | "linear", "prefill-decode", "power-cap", or ``{"law": .., ..}`` with parameters |
"""

from __future__ import annotations

import dataclasses
from collections.abc import Container, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from dcgrid_env.core.checked import FieldError, Plain, as_tuples, changed_fields, from_mapping, inside
from dcgrid_env.core.digest import digest
from dcgrid_env.devices import Device, is_known
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.datacenter.feature_settings import SETTINGS
from dcgrid_env.devices.datacenter.plain_laws import CLOCK_LAWS, plain_law
from dcgrid_env.devices.faults import Fault
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.devices.ride_through.rules import RideThrough
from dcgrid_env.devices.ride_through.sags import SAG_SEQUENCES, Sag
from dcgrid_env.devices.ride_through.voltage_curve import RideThroughCurve, plain_curve
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.grid import FEEDER_REGISTRY, AnyFeeder, Feeder, FeederError, ThreePhaseFeeder, load_feeder, read_feeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.assembly import PARTS
from dcgrid_env.scenario.cost import CostWeights
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.grid_request import LoadTarget
from dcgrid_env.traces import SUN, TRACE_SOURCES, PowerTrace, ProfileTable

_CHANGED_ONLY = (*SETTINGS.values(), RideThrough, LoadTarget, Fault, Sag)
"""Dataclasses of which the plain form leaves out fields at their default."""
_COMPLETE = (*PARTS.values(), CapacitorControl, RegulatorControl, RandomFeeders)


def to_data(value: object) -> Plain:
    """Return a field's value in plain form; an object without one, such as a recording made in Python, unchanged."""
    if isinstance(value, AnyFeeder):
        return _feeder_to_data(value)
    if isinstance(value, PowerTrace | ProfileTable):
        return value.asked_by or value
    if isinstance(value, RideThroughCurve):
        return plain_curve(value)
    if type(value) in CLOCK_LAWS.values():
        return plain_law(value)
    if isinstance(value, CostWeights):
        return to_data(value._asdict())
    if isinstance(value, _CHANGED_ONLY):
        return _fields_to_data(value, changed_fields(value))
    if isinstance(value, _COMPLETE):
        return _fields_to_data(value)
    if isinstance(value, Device) and is_known(type(value)):
        return {"kind": value.kind, **_fields_to_data(value)}
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, Mapping):
        return {key: to_data(item) for key, item in value.items()}
    value = as_tuples(value)
    return [to_data(item) for item in value if not is_equipment(item)] if isinstance(value, tuple) else value


def _fields_to_data(instance: Any, names: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the plain forms of some fields of a dataclass instance, of all without ``names``."""
    data: dict[str, Any] = {}
    for field in dataclasses.fields(instance):
        if names is None or field.name in names:
            value = getattr(instance, field.name)
            is_mapping = field.metadata.get("is_mapping") and isinstance(value, tuple)
            data[field.name] = to_data(dict(value) if is_mapping else value)
    return data


def refuse_objects(scenario: str, path: str, value: object) -> None:
    """Raise ScenarioError, naming field and remedy, where something in a plain form has none."""
    if isinstance(value, dict):
        for key, item in value.items():
            refuse_objects(scenario, f"{path}.{key}", item)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            refuse_objects(scenario, f"{path}[{i}]", item)
    elif not isinstance(value, bool | int | float | str | None):
        remedy = _REMEDIES.get(type(value), "give one of those that have a name")
        raise ScenarioError(
            f"scenario {scenario!r}: {path} is a {type(value).__name__} that is in no file and has no name; {remedy}"
        )


_REMEDIES: dict[type[Any], str] = {
    Feeder: "write it, feeder.to_csv(folder), and give the folder instead",
    ThreePhaseFeeder: "write it, feeder.to_csv(folder), and give the folder instead",
    ProfileTable: "write it, traces.write_profiles, and give the file's path instead",
    PowerTrace: "write it into a file and give its path, or a recording's name, instead",
}


def _feeder_to_data(feeder: AnyFeeder) -> Plain:
    """Name or folder that gives a feeder of the same content; the feeder itself where there is none."""
    content = digest([("", feeder)])
    if feeder.name in FEEDER_REGISTRY and digest([("", load_feeder(feeder.name))]) == content:
        return feeder.name
    try:
        is_there = feeder.folder is not None and digest([("", read_feeder(feeder.folder))]) == content
    except (FeederError, OSError):
        is_there = False
    return str(feeder.folder) if is_there else feeder


PATHS: dict[str, Container[str]] = {
    "feeder": FEEDER_REGISTRY, "trace": TRACE_SOURCES, "injection": (SUN,), "file": (), "classes": (),
}  # fmt: skip
"""Fields that may name a file or folder, with the texts that are names of something else."""


def reads_files(name: str, value: object) -> bool:
    """Whether the plain value of a field names a file or folder, whose content may differ from call to call."""
    name = name.rpartition(".")[2]
    if isinstance(value, Mapping):
        return any(reads_files(str(key), item) for key, item in value.items())
    if name == "devices" and isinstance(value, list | tuple):
        return any(reads_files("device", item) for item in value)
    if name == "trace" and isinstance(value, list | tuple):
        return True
    return name in PATHS and (isinstance(value, Path) or (isinstance(value, str) and value not in PATHS[name]))


def feeder_from_data(value: object) -> Any:
    """Return a feeder for its name or folder, random ones for a mapping of fields; any other value unchanged.

    FeederError for an unknown feeder, FieldError for an invalid field.
    """
    if not isinstance(value, str | Path):
        with inside("Scenario", "feeder"):
            return from_mapping(RandomFeeders, value)
    if isinstance(value, str) and value in FEEDER_REGISTRY:
        return load_feeder(value)
    try:
        is_folder = Path(value).is_dir()
    except (OSError, ValueError):  # a name too long, or with a null character
        is_folder = False
    if is_folder:
        return read_feeder(value)
    raise FeederError(f"{FEEDER_REGISTRY.unknown(str(value))}; or give a folder of your own")


def sags_from_data(value: object) -> Any:
    """Return the sags of a recorded sequence for its name; any other value unchanged."""
    if not isinstance(value, str):
        return value
    if value not in SAG_SEQUENCES:
        raise FieldError("Scenario", "sags", value, f"choose one of {', '.join(SAG_SEQUENCES)}, or give a list of sags")
    return SAG_SEQUENCES[value]()
