"""Makes a scenario's parts from its arguments: objects, mappings of plain data, and fields by their paths."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING
from typing import Any

import numpy as np

from dcgrid_env.core.checked import DEEPEST, FieldError, UnknownFieldError, is_deep
from dcgrid_env.core.suggestions import unknown
from dcgrid_env.devices import DEVICE_REGISTRY, DataCenters, Device, Inverters, device_kind
from dcgrid_env.scenario.background import Background
from dcgrid_env.scenario.cost import Cost, changed_weights
from dcgrid_env.scenario.errors import ScenarioError, UnknownArgumentError, located
from dcgrid_env.scenario.field_names import ALIASES, FORMER
from dcgrid_env.scenario.grid_control import GridControl
from dcgrid_env.scenario.grid_request import GridRequest
from dcgrid_env.scenario.load_profiles import LoadProfiles
from dcgrid_env.scenario.plain import faults_from_plain, feeder_from_plain
from dcgrid_env.scenario.plain_sags import sags_from_plain
from dcgrid_env.scenario.sensing import Sensing
from dcgrid_env.scenario.workload import Workload

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
_PLAIN = {"feeder": feeder_from_plain, "faults": faults_from_plain, "sags": sags_from_plain}
NO_DATA_CENTERS = DataCenters(count=0, p_rated_kw=1.0, s_rated_share=1.0, q_max_share=0.0)
"""Group of a scenario without data centres."""
NO_INVERTERS = Inverters()
"""Group of a scenario without inverters."""


def assembled(base: Any, scenario_fields: Iterable[str], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a scenario: those of ``base`` (None for a new one) with the given values.

    Parameters
    ----------
    base
        A scenario, or None.
    scenario_fields
        Names of the fields of a scenario.
    given
        Values by the name of a field, of a part or of a group of devices, by a path such as ``sensing.noise_pu``, or
        by a short name (``field_names``). A mapping for a part or group changes the fields that it names and leaves
        the others.

    Raises
    ------
    TypeError
        For a name that is none of these.
    ScenarioError
        For an invalid value.
    """
    refuse_deep(given)
    names = list(scenario_fields)
    fields = {} if base is None else {name: getattr(base, name) for name in names}
    fields |= {name: _PLAIN[name](value) if name in _PLAIN else value for name, value in given.items() if name in names}
    name = fields.get("name")
    by_path: dict[str, dict[str, Any]] = {}
    for key, value in given.items():
        if key in names or key in GROUPS:
            continue
        part, field = _part_and_field(key, names)
        if field in by_path.setdefault(part, {}):
            raise ScenarioError(f"scenario {name!r}: {part}.{field} is given twice; give it once")
        by_path[part][field] = value
    for part, changed in by_path.items():
        if not isinstance(given.get(part, {}), Mapping):
            paths = ", ".join(f"{part}.{field}" for field in changed)
            raise ScenarioError(f"scenario {name!r}: {paths} is given, and {part} as a whole too; give one")
    for part in (*PARTS, *GROUPS, "devices"):
        if part in given and given[part] is None:
            raise ScenarioError(f"scenario {name!r}: {part} is None; leave it out, or give what it is to be")
    for part, kind in PARTS.items():
        if part in given or part in by_path or part not in fields:
            start = getattr(base, part, None)
            fields[part] = _part(name, part, kind, start, given.get(part), by_path.get(part, {}))
    changes = {group: (given.get(group), by_path.get(group, {})) for group in GROUPS if {group} & {*given, *by_path}}
    if base is None and "devices" not in given and not changes:
        raise ScenarioError(f"scenario {name!r}: devices is missing; give it, a list of groups of devices")
    fields["devices"] = _devices(name, base, given.get("devices"), changes)
    return fields


def refuse_deep(given: Mapping[str, Any]) -> None:
    """Raise ScenarioError for a value of lists and mappings too deep within each other."""
    for name, value in given.items():
        if is_deep(value):
            raise ScenarioError(f"{name} is nested more than {DEEPEST} deep; give it without so many brackets")


def _part_and_field(key: str, names: list[str]) -> tuple[str, str]:
    """Return the part or group of devices, and its field, for a path or a short name."""
    part, _, field = ALIASES.get(key, key).partition(".")
    if field and part in (*PARTS, *GROUPS):
        return part, field
    if key in FORMER:
        raise UnknownArgumentError(f"no scenario field {key!r}: it is {FORMER[key]} now", key)
    known = (*names, *GROUPS, *ALIASES, *(f"{of}.{field}" for of, kind in _kinds() for field in _fields(kind)))
    raise UnknownArgumentError(unknown("scenario field", key, known, "`dcgrid list fields` lists all"), key)


def _kinds() -> Iterator[tuple[str, type[Any]]]:
    """Return the classes of the parts and of the groups of devices, by attribute."""
    yield from PARTS.items()
    yield from ((group, device_kind(kind)) for group, kind in GROUPS.items())


def _fields(kind: type[Any]) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]


def _part(scenario: Any, path: str, kind: type[Any], start: Any, given: object, by_path: Mapping[str, Any]) -> Any:
    """Return one part or group of devices: ``start`` with the given changes, or a new one."""
    changes = dict(by_path)
    if isinstance(given, Mapping):
        for field, value in given.items():
            if field == "kind" and value == getattr(kind, "kind", None):
                continue  # plain groups of devices name it
            if field in changes:
                raise ScenarioError(f"scenario {scenario!r}: {path}.{field} is given twice; give it once")
            changes[field] = value
    elif given is not None:
        if not isinstance(given, kind):
            raise ScenarioError(
                f"scenario {scenario!r}: {path} is {given!r}; give {kind.__name__}(...) or a mapping of its fields"
            )
        start = given
    with located(scenario, path):
        for field in changes:
            if "." in field:
                raise FieldError(
                    path, field, ..., f"is too deep a path; give {path}.{field.partition('.')[0]} a mapping"
                )
            if field not in _fields(kind):
                raise UnknownFieldError(path, field, ..., _fields(kind))
        buses = changes.get("buses")
        listed = isinstance(buses, list | tuple) or (isinstance(buses, np.ndarray) and buses.ndim == 1)
        if kind is DataCenters and "count" not in changes and listed:
            changes["count"] = len(changes["buses"])
        if start is not None and isinstance(changes.get("weights"), Mapping):
            changes["weights"] = changed_weights(start.weights, changes["weights"])
        if start is None:
            for field in dataclasses.fields(kind):
                if field.default is MISSING and field.default_factory is MISSING and field.name not in changes:
                    raise FieldError(path, field.name, ..., "is missing; give it")
            return kind(**changes)
        return dataclasses.replace(start, **changes) if changes else start


def _devices(
    scenario: Any, base: Any, given: object, changes: Mapping[str, tuple[Any, Mapping[str, Any]]]
) -> tuple[Any, ...]:
    """Return the groups of devices, with those of data centres and of inverters made or changed."""
    if given is None:
        groups = [] if base is None else list(base.devices)
    else:
        listed = given if isinstance(given, list | tuple) else (given,)
        groups = [_device(scenario, f"devices[{i}]", device) for i, device in enumerate(listed)]
    for place, (name, kind) in enumerate(GROUPS.items()):
        if name not in changes:
            continue
        there = [i for i, device in enumerate(groups) if device.kind == kind]
        if len(there) > 1:
            raise ScenarioError(
                f"scenario {scenario!r} has {len(there)} groups of kind {kind!r}; give devices, not {name}"
            )
        if there and given is not None and isinstance(changes[name][0], Device):
            raise ScenarioError(f"scenario {scenario!r}: {name} is given, and devices has such a group; give one")
        start = groups[there[0]] if there else None
        group = _part(scenario, name, device_kind(kind), start, *changes[name])
        if there:
            groups[there[0]] = group
        else:
            groups.insert(place, group)
    return _with_both(groups)


def _with_both(groups: list[Any]) -> tuple[Any, ...]:
    """Return the groups, with an empty one of data centres first or of inverters last if it is missing."""
    kinds = [group.kind for group in groups]
    front = () if "datacenter" in kinds else (NO_DATA_CENTERS,)
    return (*front, *groups, *(() if "inverter" in kinds else (NO_INVERTERS,)))


def _device(scenario: Any, path: str, given: object) -> Any:
    if not isinstance(given, Mapping):
        if isinstance(given, type) or not isinstance(given, Device):
            kinds = ", ".join(device_kind(kind).__name__ for kind in DEVICE_REGISTRY)
            raise ScenarioError(f"scenario {scenario!r}: {path} is {given!r}; give a device ({kinds}) or a mapping")
        return given
    fields = dict(given)
    kind = fields.pop("kind", None)
    if not isinstance(kind, str) or kind not in DEVICE_REGISTRY:
        raise ScenarioError(f"scenario {scenario!r}: {path}.kind: {DEVICE_REGISTRY.unknown(kind)}")
    return _part(scenario, path, device_kind(kind), None, fields, {})
