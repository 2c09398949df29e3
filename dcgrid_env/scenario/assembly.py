"""A scenario's parts out of what it is given: objects, mappings of plain data, and fields by their flat names."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import MISSING
from typing import Any

import numpy as np

from dcgrid_env.core.suggestions import unknown
from dcgrid_env.devices import DEVICE_REGISTRY, DataCenters, Device, Inverters, device_kind
from dcgrid_env.scenario.background import Background
from dcgrid_env.scenario.cost import Cost, changed_weights
from dcgrid_env.scenario.errors import ScenarioError, UnknownArgumentError, located
from dcgrid_env.scenario.flat_names import FLAT
from dcgrid_env.scenario.grid_control import GridControl
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
}
_PLAIN = {"feeder": feeder_from_plain, "faults": faults_from_plain, "sags": sags_from_plain}
FLAT_OF = {where: name for name, where in FLAT.items()}
"""Flat name of a part's field, by part and field."""
NO_DATA_CENTERS = DataCenters(count=0, p_rated_kw=1.0, s_rated_share=1.0, q_max_share=0.0)
"""The group that stands in a scenario without data centres."""
NO_INVERTERS = Inverters()
"""The group that stands in a scenario without inverters."""
_ORDER = ("datacenter", "inverter")
"""Kinds of devices that have flat names, in the order in which a scenario made of flat names has them."""


def assembled(base: Any, own: Iterable[str], given: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a scenario: those of ``base`` (None for a new one) with what is given put in.

    Parameters
    ----------
    base
        A scenario, or None.
    own
        Names of a scenario's own fields.
    given
        Values by the name of a field, of a part or of a part's field (``flat_names``). A mapping for a part changes
        the fields that it names and leaves the others.

    Raises
    ------
    TypeError
        For a name that is none of these.
    ScenarioError
        For an invalid value.
    """
    own = list(own)
    for key in given:
        if key not in own and key not in FLAT:
            how = unknown("scenario field", key, (*own, *FLAT), "`dcgrid list fields` lists all")
            raise UnknownArgumentError(how, key)
    fields = {} if base is None else {name: getattr(base, name) for name in own}
    fields |= {name: _PLAIN[name](value) if name in _PLAIN else value for name, value in given.items() if name in own}
    flat: dict[str, dict[str, tuple[str, Any]]] = {}
    for key, value in given.items():
        if key in FLAT:
            part, field = FLAT[key]
            flat.setdefault(part, {})[field] = (key, value)
    name = fields.get("name")
    for field, (key, value) in flat.pop("", {}).items():
        if field in given:
            raise ScenarioError(f"scenario {name!r}: {field} and {key} are one field; give one of them")
        fields[field] = value
    for part in (*PARTS, "devices"):
        if part in given and given[part] is None:
            raise ScenarioError(f"scenario {name!r}: {part} is None; leave it out, or give what it is to be")
    for part, kind in PARTS.items():
        if part in given or part in flat or part not in fields:
            start = getattr(base, part, None)
            fields[part] = _part(name, part, kind, start, given.get(part), flat.get(part, {}))
    if base is None and "devices" not in given and not any(kind in flat for kind in _ORDER):
        raise ScenarioError(f"scenario {name!r}: devices is missing; give it, a list of groups of devices")
    by_kind = {kind: flat[kind] for kind in _ORDER if kind in flat}
    fields["devices"] = _devices(name, base, given.get("devices"), by_kind)
    return fields


def _part(
    scenario: Any, path: str, kind: type[Any], start: Any, given: Any, flat: Mapping[str, tuple[str, Any]]
) -> Any:
    """One part: ``start`` changed by what is given, or a new one."""
    changes = {field: value for field, (_, value) in flat.items()}
    names = {field: name for field, (name, _) in flat.items()}
    if isinstance(given, Mapping):
        given = {key: value.item() if isinstance(value, np.generic) else value for key, value in given.items()}
        from dcgrid_env.scenario.plain_parts import checked_mapping  # brings the library of types, so not on import

        by_path = checked_mapping(scenario, path, kind, given)
        for field in by_path:
            if field in changes:
                raise ScenarioError(f"scenario {scenario!r}: {path}.{field} and {names[field]} are one field; give one")
        changes |= by_path
    elif given is not None:
        if not isinstance(given, kind):
            raise ScenarioError(
                f"scenario {scenario!r}: {path} is {given!r}; give {kind.__name__}(...) or a mapping of its fields"
            )
        start = given
    if kind is DataCenters and "count" not in changes and isinstance(changes.get("buses"), list | tuple | np.ndarray):
        changes["count"] = len(changes["buses"])
    with located(scenario, path, names):
        if start is not None and isinstance(changes.get("weights"), Mapping):
            changes["weights"] = changed_weights(start.weights, changes["weights"])
        if start is None:
            for field in dataclasses.fields(kind):
                if field.default is MISSING and field.default_factory is MISSING and field.name not in changes:
                    where = FLAT_OF.get((path, field.name), f"{path}.{field.name}")
                    raise ScenarioError(f"scenario {scenario!r}: {where} is missing; give it")
            return kind(**changes)
        return dataclasses.replace(start, **changes) if changes else start


def _devices(
    scenario: Any, base: Any, given: Any, flat: Mapping[str, Mapping[str, tuple[str, Any]]]
) -> tuple[Any, ...]:
    """The groups of devices, those of flat names made or changed."""
    if given is None:
        groups = [] if base is None else list(base.devices)
    else:
        listed = given if isinstance(given, list | tuple) else (given,)
        groups = [_device(scenario, f"devices[{i}]", device) for i, device in enumerate(listed)]
    for place, kind in enumerate(_ORDER):
        if kind not in flat and not (base is None and given is None):
            continue
        at = [i for i, device in enumerate(groups) if device.kind == kind]
        if len(at) > 1:
            name = next(iter(flat[kind].values()))[0]
            raise ScenarioError(
                f"scenario {scenario!r} has {len(at)} groups of kind {kind!r}; give devices, not {name}"
            )
        start = groups[at[0]] if at else None
        group = _part(scenario, kind, device_kind(kind), start, None, flat.get(kind, {}))
        groups[at[0] if at else min(place, len(groups)) : (at[0] + 1 if at else min(place, len(groups)))] = [group]
    return _with_both(groups)


def _with_both(groups: list[Any]) -> tuple[Any, ...]:
    """The groups with an empty one of data centres in front, or of inverters behind, where there is none."""
    kinds = [group.kind for group in groups]
    front = () if "datacenter" in kinds else (NO_DATA_CENTERS,)
    return (*front, *groups, *(() if "inverter" in kinds else (NO_INVERTERS,)))


def _device(scenario: Any, path: str, given: Any) -> Any:
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
