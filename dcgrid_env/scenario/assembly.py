"""Fields of a scenario from its arguments: objects, mappings of fields, and fields by their paths.

A field of a part is given as ``sensing={"noise_pu": 0.005}``, as a table ``[sensing]`` of a scenario file, or by its
path: ``--set sensing.noise_pu=0.005``, and ``**{"sensing.noise_pu": 0.005}`` in Python.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from dcgrid_env.core.checked import DEEPEST, FieldError, from_mapping, inside, is_deep
from dcgrid_env.core.digest import digest
from dcgrid_env.core.suggestions import unknown
from dcgrid_env.devices import DEVICE_REGISTRY, DataCenters, Device, Inverters, device_kind
from dcgrid_env.grid import is_bundled
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.cost import Cost, changed_weights
from dcgrid_env.scenario.errors import ScenarioError, UnknownArgumentError
from dcgrid_env.scenario.grid_control import GridControl
from dcgrid_env.scenario.grid_request import GridRequest
from dcgrid_env.scenario.load_profiles import LoadProfiles
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.workload import Background, Workload

PARTS: dict[str, type[Any]] = {
    "workload": Workload,
    "background": Background,
    "sensing": Sensing,
    "cost": Cost,
    "grid_control": GridControl,
    "grid_request": GridRequest,
    "load_profiles": LoadProfiles,
}
GROUPS = {"datacenters": DataCenters.kind, "inverters": Inverters.kind}
"""Kinds of the groups of devices that every scenario has, by attribute; in their order."""
ALIASES = {
    "n_datacenters": "datacenters.count",
    "trace": "workload.trace",
    "observe": "sensing.observe",
    "weights": "cost.weights",
    "reward": "cost.reward",
}
"""Paths of common fields by their short names."""
_RENAMED = {
    "datacenters": """
        datacenter_buses=buses p_rated_kw idle_share f_min_mhz f_max_mhz s_rated_share q_max_share dvfs=clock_law
        boost_share datacenter_phases=phases datacenter_ride_through=ride_through datacenter_smoothing=smoothing
        datacenter_cooling=cooling datacenter_routing=routing datacenter_batching=batching datacenter_service=service
        datacenter_storage=storage
    """,
    "inverters": """
        inverter_buses=buses inverter_s_kva=s_rated_kva inverter_phases=phases inverter_ride_through=ride_through
        inverter_trace=injection
    """,
    "workload": "trace_scale recording_split trace_window=window site_correlation compute_share full_load_s",
    "background": "capacitors load_sigma load_rho start_hour",
    "sensing": """
        voltage_noise_pu=noise_pu measurement_delay=delay_steps preview observe_loading=loading r_model_share
        x_model_share
    """,
    "grid_control": "regulators capacitor_banks=capacitors capacitor_settings",
    "cost": "band_pu voltage_cost=voltage ramp_limit_kw_per_s ramp_window_s voltage_step_limit_pu",
}
FORMER = {"v0_pu": "source_voltage_pu"} | {
    words.partition("=")[0]: f"{part}.{words.rpartition('=')[2]}"
    for part, renamed in _RENAMED.items()
    for words in renamed.split()
}
"""Paths of fields by names that are refused; the error gives the path. Fingerprints use these names."""
_NO_DATA_CENTERS = DataCenters(count=0, p_rated_kw=1.0, s_rated_share=1.0, q_max_share=0.0)
_NO_INVERTERS = Inverters()


def assembled(base: Any, scenario_fields: Iterable[str], arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a scenario: those of ``base`` (None for a new one) with the given values.

    Parameters
    ----------
    base
        A scenario, or None.
    scenario_fields
        Names of the fields of a scenario.
    arguments
        Values by the name of a field, of a part or of a group of devices, by a path such as ``sensing.noise_pu``, or
        by a short name (``ALIASES``). A mapping for a part or group changes the fields that it names and leaves the
        others.

    Raises
    ------
    TypeError
        For a name that is none of these.
    FieldError, ScenarioError
        For an invalid value.
    """
    refuse_deep(arguments)
    names = list(scenario_fields)
    fields = {} if base is None else {name: getattr(base, name) for name in names}
    fields |= {name: value for name, value in arguments.items() if name in names and name not in PARTS}
    whole, changes = _whole_and_changes(arguments, names)
    for part, kind in PARTS.items():
        fields[part] = _changed(part, kind, whole.get(part, fields.get(part)), changes.get(part, {}))
    fields["devices"] = _devices(base, arguments, whole, changes)
    return fields


def with_overrides(base: Any, overrides: Mapping[str, Any]) -> Any:
    """Return a scenario with some fields changed.

    A scenario's ``source_voltage_pu`` was chosen for its feeder. It therefore becomes that of the new feeder's file,
    unless the overrides contain it, or the feeder is bundled, random, or a variant of the scenario's feeder made in
    Python.
    """
    made = base.replace(**overrides)
    if "feeder" not in overrides or "source_voltage_pu" in overrides or not _brings_voltage(made.feeder, base.feeder):
        return made
    return made.replace(source_voltage_pu=made.feeder.v0_pu)


def _brings_voltage(feeder: Any, before: Any) -> bool:
    if isinstance(feeder, RandomFeeders) or is_bundled(feeder):
        return False
    if isinstance(before, RandomFeeders):
        return True
    if feeder.folder is None:
        return feeder.name != before.name
    return digest([("", feeder)]) != digest([("", before)])


def refuse_deep(arguments: Mapping[str, Any]) -> None:
    """Raise ScenarioError for a value of lists and mappings too deep within each other."""
    for name, value in arguments.items():
        if is_deep(value):
            raise ScenarioError(f"{name} is nested more than {DEEPEST} deep; give it without so many brackets")


def _whole_and_changes(
    arguments: Mapping[str, Any], names: list[str]
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Return the parts and groups that are replaced as a whole, and the fields that are changed in others."""
    whole: dict[str, Any] = {}
    changes: dict[str, dict[str, Any]] = {}
    for key, value in arguments.items():
        if key in (*PARTS, *GROUPS, "devices") and not isinstance(value, Mapping):
            if value is None:
                raise FieldError("Scenario", key, None, "leave it out, or give what it is to be")
            whole[key] = value
        if (key in names and key not in PARTS) or key in whole:
            continue
        part, field = (key, "") if key in (*PARTS, *GROUPS) else _path(key, names)
        changed = changes.setdefault(part, {})
        for name, item in ({field: value} if field else value).items():
            if name in changed:
                raise FieldError("Scenario", f"{part}.{name}", ..., "is given twice; give it once")
            changed[name] = item
    for part in whole.keys() & changes:
        paths = ", ".join(f"{part}.{field}" for field in changes[part])
        raise FieldError("Scenario", paths, ..., f"is given, and {part} as a whole too; give one")
    return whole, changes


def _path(key: str, names: list[str]) -> tuple[str, str]:
    """Return the part or group of devices, and its field, for a path or a short name."""
    part, _, field = ALIASES.get(key, key).partition(".")
    if field and part in (*PARTS, *GROUPS):
        return part, field
    if key in FORMER:
        raise UnknownArgumentError(f"no scenario field {key!r}: it is {FORMER[key]} now", key)
    kinds = PARTS | {group: device_kind(kind) for group, kind in GROUPS.items()}
    paths = (f"{part}.{field.name}" for part, kind in kinds.items() for field in dataclasses.fields(kind))
    known = (*names, *GROUPS, *ALIASES, *paths)
    raise UnknownArgumentError(unknown("scenario field", key, known, "`dcgrid list fields` lists all"), key)


def _changed(path: str, kind: type[Any], start: Any, changes: Mapping[str, Any]) -> Any:
    """Return a part or group of devices: ``start`` with some fields changed, or a new one if ``start`` is None."""
    if start is not None and not isinstance(start, kind):
        raise FieldError("Scenario", path, start, f"give {kind.__name__}(...) or a mapping of its fields")
    if start is not None and not changes:
        return start
    with inside("Scenario", path):
        fields = {field: v for field, v in changes.items() if (field, v) != ("kind", getattr(kind, "kind", None))}
        for field in fields:
            if "." in field:
                remedy = f"is too deep a path; give {path}.{field.partition('.')[0]} a mapping"
                raise FieldError(path, field, ..., remedy)
        buses = fields.get("buses")
        listed = isinstance(buses, list | tuple) or (isinstance(buses, np.ndarray) and buses.ndim == 1)
        if kind is DataCenters and "count" not in fields and listed:
            fields["count"] = len(fields["buses"])
        if start is not None and "weights" in fields:
            fields["weights"] = changed_weights(start.weights, fields["weights"])
        return from_mapping(kind, fields, start)


def _devices(
    base: Any, arguments: Mapping[str, Any], whole: Mapping[str, Any], changes: Mapping[str, Mapping[str, Any]]
) -> tuple[Any, ...]:
    """Return the groups of devices, with those of data centres and of inverters made or changed."""
    groups, is_listed = [] if base is None else list(base.devices), "devices" in arguments
    if is_listed:
        value = arguments["devices"]
        groups = [_device(i, device) for i, device in enumerate(value if isinstance(value, list | tuple) else (value,))]
    elif base is None and not {*GROUPS} & {*whole, *changes}:
        raise FieldError("Scenario", "devices", ..., "is missing; give it, a list of groups of devices")
    for place, (name, kind) in enumerate(GROUPS.items()):
        if name not in whole and name not in changes:
            continue
        there = [i for i, device in enumerate(groups) if device.kind == kind]
        if len(there) > 1:
            raise FieldError("Scenario", name, ..., f"is {len(there)} groups of kind {kind!r}; give devices")
        if there and is_listed and name in whole:
            raise FieldError("Scenario", name, ..., "is given, and devices has such a group; give one")
        position = there[0] if there else place
        start = whole.get(name, groups[position] if there else None)
        groups[position : position + len(there)] = [_changed(name, device_kind(kind), start, changes.get(name, {}))]
    kinds = [group.kind for group in groups]
    front = [] if DataCenters.kind in kinds else [_NO_DATA_CENTERS]
    return (*front, *groups, *([] if Inverters.kind in kinds else [_NO_INVERTERS]))


def _device(place: int, value: object) -> Any:
    path = f"devices[{place}]"
    if not isinstance(value, Mapping):
        if isinstance(value, type) or not isinstance(value, Device):
            kinds = ", ".join(device_kind(kind).__name__ for kind in DEVICE_REGISTRY)
            raise FieldError("Scenario", path, value, f"give a device ({kinds}) or a mapping")
        return value
    fields = dict(value)
    kind = fields.pop("kind", None)
    if not isinstance(kind, str) or kind not in DEVICE_REGISTRY:
        raise FieldError("Scenario", f"{path}.kind", kind, DEVICE_REGISTRY.unknown(str(kind)))
    return _changed(path, device_kind(kind), None, fields)
