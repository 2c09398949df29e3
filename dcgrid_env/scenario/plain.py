"""Plain data for a scenario's fields, for JSON, YAML, TOML and ``gymnasium.EnvSpec.to_json``.

| field | plain form | object |
|---|---|---|
| feeder | a feeder's name (bundled, or of another package), or the path of a folder | Feeder |
| feeder | a mapping of the fields of random feeders ``{"n_bus": 60, "style": "urban", ..}`` | RandomFeeders |
| devices | a list of mappings, each with its ``kind`` | tuple of DataCenters, Inverters, .. |
| workload, background, sensing, cost, grid_control | a mapping of their fields | Workload, Background, Sensing, .. |
| grid_request | a mapping of its fields | GridRequest |
| load_profiles | a mapping of its fields | LoadProfiles |
| file of ``load_profiles`` | the path of a file | ProfileTable |
| classes of ``load_profiles`` | a mapping from loads to classes, or the path of a file | pairs of load and class |
| datacenters, inverters | a mapping of their fields | DataCenters, Inverters |
| regulators, capacitors of ``grid_control`` | a word, or a mapping from banks to words | pairs of bank and word |
| capacitor_settings, regulator_settings | a mapping of fields | CapacitorControl, RegulatorControl |
| offset_v of ``regulator_settings`` | a number, or a mapping from regulators to numbers | pairs of name and number |
| profile_pu of ``cost`` | a number, or a mapping from buses or nodes to numbers | pairs of bus or node and number |
| targets of ``grid_request`` | a list of mappings of the fields of LoadTarget | tuple of LoadTarget |
| weights | a mapping of names to numbers; weights that it leaves out keep their value | CostWeights |
| faults | a list of mappings ``{"among": [..], "begin_s": [low, high], "duration_s": [low, high]}`` | tuple of Fault |
| sags | the name of a recorded sequence, or a list of mappings of the fields of Sag | tuple of Sag |
| ride_through | a curve's name, or a mapping of the rule's fields | UpsRideThrough of sites, RideThrough of inverters |
| storage, smoothing, cooling of sites | a mapping of its fields | SiteStorage, PowerSmoothing, Cooling |
| storage, routing, batching, service of sites | a mapping of their fields | SiteStorage, Routing, .. |
| clock_law | "linear", "prefill-decode", "power-cap", or ``{"law": .., ..}`` with parameters | a clock law |
| trace | a generator's name, a recording's name or file, or a list of recordings | tuple of PowerTrace |
| injection | "pv", a list of shares, or a recording's name or file | PowerTrace |
| other sequences | a list | a tuple |
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from dcgrid_env.core.checked import Plain, changed_fields
from dcgrid_env.core.digest import digest
from dcgrid_env.devices import Device, is_known
from dcgrid_env.devices.capacitor_bank.capacitor_control import CapacitorControl
from dcgrid_env.devices.datacenter.batching import Batching
from dcgrid_env.devices.datacenter.cooled_site import Cooling
from dcgrid_env.devices.datacenter.plain_laws import CLOCK_LAWS, plain_law
from dcgrid_env.devices.datacenter.power_smoothing import PowerSmoothing
from dcgrid_env.devices.datacenter.service_levels import ServiceLevels
from dcgrid_env.devices.datacenter.site_storage import SiteStorage
from dcgrid_env.devices.datacenter.work_routing import Routing
from dcgrid_env.devices.faults import Fault
from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.devices.ride_through.rules import RideThrough, plain_rule
from dcgrid_env.devices.ride_through.sags import Sag
from dcgrid_env.devices.tap_changer.regulator_control import RegulatorControl
from dcgrid_env.grid import FEEDER_REGISTRY, AnyFeeder, Feeder, FeederError, ThreePhaseFeeder, load_feeder, read_feeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.background import Background
from dcgrid_env.scenario.cost import Cost, CostWeights
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.grid_control import GridControl
from dcgrid_env.scenario.grid_request import GridRequest, LoadTarget
from dcgrid_env.scenario.load_profiles import LoadProfiles
from dcgrid_env.scenario.plain_sags import sag_to_plain
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.workload import Workload
from dcgrid_env.traces import SUN, TRACE_SOURCES, PowerTrace, ProfileTable


def to_plain(value: object) -> Plain:
    """Return a field's value in plain form; an object without one, such as a recording made in Python, unchanged."""
    if isinstance(value, CostWeights):
        return {key: to_plain(weight) for key, weight in value._asdict().items()}
    if isinstance(value, Fault):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {key: to_plain(v) for key, v in fields.items() if v != (math.inf, math.inf)}
    if isinstance(value, Sag):
        return sag_to_plain(value)
    if isinstance(value, SiteStorage | PowerSmoothing | Cooling | Routing | Batching | ServiceLevels | LoadTarget):
        return {name: to_plain(field) for name, field in changed_fields(value).items()}
    if isinstance(value, RideThrough):
        return plain_rule(value)
    if isinstance(value, Workload | Background | Sensing | CapacitorControl | GridRequest):
        return _fields_to_plain(value)
    if isinstance(value, Cost | GridControl | RegulatorControl | LoadProfiles):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {key: to_plain(dict(given) if _is_mapping(given) else given) for key, given in fields.items()}
    if isinstance(value, Device) and is_known(type(value)):
        return {"kind": value.kind, **_fields_to_plain(value)}
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, AnyFeeder):
        return _feeder_to_plain(value)
    if isinstance(value, RandomFeeders):
        return _fields_to_plain(value)
    if isinstance(value, PowerTrace | ProfileTable):
        return value.asked_by or value
    if type(value) in CLOCK_LAWS.values():
        return plain_law(value)
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value if not is_equipment(item)]
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.item() if isinstance(value, np.generic) else value


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
            f"scenario {scenario!r}: {path} is a {type(value).__name__} that stands in no file that is known; {remedy}"
        )


_REMEDIES: dict[type[Any], str] = {
    Feeder: "write it, feeder.to_csv(folder), and give the folder instead",
    ThreePhaseFeeder: "write it, feeder.to_csv(folder), and give the folder instead",
    ProfileTable: "write it, traces.write_profiles, and give the file's path instead",
    PowerTrace: "write it into a file and give its path, or a recording's name, instead",
}


def _feeder_to_plain(feeder: AnyFeeder) -> Plain:
    """Name or folder that gives a feeder of the same content; the feeder itself where there is none."""
    content = digest([("", feeder)])
    if feeder.name in FEEDER_REGISTRY and digest([("", load_feeder(feeder.name))]) == content:
        return feeder.name
    try:
        is_there = feeder.folder is not None and digest([("", read_feeder(feeder.folder))]) == content
    except (FeederError, OSError):
        is_there = False
    return str(feeder.folder) if is_there else feeder


def _is_mapping(value: object) -> bool:
    """Return whether a field holds the pairs of a mapping."""
    return isinstance(value, tuple) and all(isinstance(pair, tuple) and len(pair) == 2 for pair in value)


def _fields_to_plain(part: Any) -> dict[str, Any]:
    return {field.name: to_plain(getattr(part, field.name)) for field in dataclasses.fields(part)}


def reads_files(name: str, value: object) -> bool:
    """Whether the plain value of a field names a file or folder, whose content may differ from call to call."""
    name = name.rpartition(".")[2]
    if isinstance(value, Mapping):
        return any(reads_files(str(key), item) for key, item in value.items())
    if name == "devices" and isinstance(value, list | tuple):
        return any(reads_files("device", item) for item in value)
    if name == "feeder":
        return isinstance(value, Path) or (isinstance(value, str) and value not in FEEDER_REGISTRY)
    if name == "trace":
        return isinstance(value, Path | list | tuple) or (isinstance(value, str) and value not in TRACE_SOURCES)
    if name in ("file", "classes"):
        return isinstance(value, str | Path)
    return name == "injection" and isinstance(value, str | Path) and value != SUN


def feeder_from_plain(value: object) -> Any:
    """Return a feeder for its name or folder, random ones for a mapping of fields; any other value unchanged.

    FeederError for an unknown feeder, FieldError for an invalid field.
    """
    if isinstance(value, Mapping):
        return RandomFeeders.of_plain(value)
    if not isinstance(value, str | Path):
        return value
    if isinstance(value, str) and value in FEEDER_REGISTRY:
        return load_feeder(value)
    if _is_there(value, Path.is_dir):
        return read_feeder(value)
    raise FeederError(f"{FEEDER_REGISTRY.unknown(str(value))}; or give a folder of your own")


def faults_from_plain(value: object) -> Any:
    """Return faults, made from mappings where needed; any other value unchanged. ScenarioError for an invalid one."""
    if isinstance(value, Fault | Mapping):
        value = (value,)
    if not isinstance(value, list | tuple):
        return value
    keys = [field.name for field in dataclasses.fields(Fault)]
    faults = []
    for i, fault in enumerate(value):
        if isinstance(fault, Mapping):
            for key in (*fault, *(name for name in keys[:2] if name not in fault)):
                if key not in keys or key not in fault:
                    wrong = "is no key" if key not in keys else "is missing"
                    raise ScenarioError(f"faults[{i}]: {key!r} {wrong}; give {', '.join(keys)}, the last if need be")
            try:
                # JSON proper has no infinity: no duration, or null, is for good.
                given = {key: v for key, v in fault.items() if not (key == "duration_s" and v is None)}
                fault = Fault(**{key: tuple(v) if isinstance(v, list | np.ndarray) else v for key, v in given.items()})
            except (TypeError, ValueError) as error:
                raise ScenarioError(f"faults[{i}]: {error}") from None
        faults.append(fault)
    return tuple(faults)


def _is_there(path: str | Path, kind: Callable[[Path], bool]) -> bool:
    try:
        return kind(Path(path))
    except (OSError, ValueError):  # a name too long, or with a null character
        return False
