"""A scenario's fields as plain data: what JSON, YAML, TOML and ``gymnasium.EnvSpec.to_json`` can hold.

| field | plain form | object |
|---|---|---|
| feeder | a shipped feeder's name, or the path of a folder | Feeder |
| weights | a mapping of names to numbers; weights that it leaves out keep their value | CostWeights |
| faults | a list of mappings ``{"among": [..], "begin_s": [low, high], "duration_s": [low, high]}`` | tuple of Fault |
| dvfs | "linear", "prefill-decode", or ``{"law": "prefill-decode", "decode_clock_share": 0.03, ..}`` | a clock law |
| trace | a generator's name, a recording's name or file, or a list of recordings | tuple of PowerTrace |
| inverter_trace | "pv", a list of shares, or a recording's name or file | PowerTrace |
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

from dcgrid_env.devices import LinearDvfs, PrefillDecodeDvfs
from dcgrid_env.devices.faults import Fault
from dcgrid_env.grid import FEEDERS, Feeder, FeederError, load_feeder
from dcgrid_env.scenario.field_checks import CostWeights, ScenarioError
from dcgrid_env.traces import RECORDINGS, SUN, TRACE_SOURCES, PowerTrace, TraceError
from dcgrid_env.traces.by_name import recorded_trace

DVFS_LAWS = {"linear": LinearDvfs, "prefill-decode": PrefillDecodeDvfs}
"""Clock laws by the name that stands for them."""


def from_plain(name: str, value: Any, weights: CostWeights) -> Any:
    """The object that a plain value of a field stands for; any other value as it is, to be checked afterwards.

    Parameters
    ----------
    name, value
        Field and value.
    weights
        What the weights are that a mapping of them leaves out.

    Raises
    ------
    ScenarioError
        For a name, key or file that there is not, naming the field, the value and the remedy.
    """
    if name == "weights" and isinstance(value, Mapping):
        return _weights(value, weights)
    convert = _CONVERSIONS.get(name)
    if convert is not None:
        value = convert(value)
    if isinstance(value, np.ndarray):
        value = value.tolist()  # a number where it has no dimension
    if isinstance(value, list):
        return tuple(item.item() if isinstance(item, np.generic) else item for item in value)
    return value.item() if isinstance(value, np.generic) else value


def to_plain(value: Any) -> Any:
    """The plain form of a field's value; an object that has none, a recording say, as it is."""
    if isinstance(value, CostWeights):
        return {key: to_plain(weight) for key, weight in value._asdict().items()}
    if isinstance(value, Fault):
        held = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {key: to_plain(v) for key, v in held.items() if v != (math.inf, math.inf)}
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, Feeder):
        return value.name if value.name in FEEDERS and load_feeder(value.name) is value else value
    for law, kind in DVFS_LAWS.items():
        if type(value) is kind:
            return {"law": law, **dataclasses.asdict(value)} if dataclasses.fields(kind) else law
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.item() if isinstance(value, np.generic) else value


def reads_files(name: str, value: Any) -> bool:
    """Whether the plain value of a field names a file or folder, whose content may differ from call to call."""
    if name == "feeder":
        return isinstance(value, str | Path) and value not in FEEDERS
    if name == "trace":
        return isinstance(value, Path | list | tuple) or (isinstance(value, str) and value not in TRACE_SOURCES)
    return name == "inverter_trace" and isinstance(value, str | Path) and value != SUN


def _weights(given: Mapping[str, Any], weights: CostWeights) -> CostWeights:
    for key in given:
        if key not in CostWeights._fields:
            raise ScenarioError(f"weights: there is no weight {key!r}; there are {', '.join(CostWeights._fields)}")
    return weights._replace(**given)


def _feeder(value: Any) -> Any:
    if not isinstance(value, str | Path) or value in FEEDERS:
        return load_feeder(value) if isinstance(value, str) else value
    if _is_there(value, Path.is_dir):
        return Feeder.from_csv(value)
    raise FeederError(f"unknown feeder {str(value)!r}; there are {', '.join(FEEDERS)}; or give a folder of your own")


def _faults(value: Any) -> Any:
    if isinstance(value, Fault | Mapping):
        value = (value,)
    if not isinstance(value, list | tuple):
        return value
    known = [field.name for field in dataclasses.fields(Fault)]
    found = []
    for i, fault in enumerate(value):
        if isinstance(fault, Mapping):
            for key in (*fault, *(name for name in known[:2] if name not in fault)):
                if key not in known or key not in fault:
                    wrong = "is no key" if key not in known else "is missing"
                    raise ScenarioError(f"faults[{i}]: {key!r} {wrong}; give {', '.join(known)}, the last if need be")
            try:
                # JSON proper has no infinity: no duration, or null, is for good.
                given = {key: v for key, v in fault.items() if not (key == "duration_s" and v is None)}
                fault = Fault(**{key: tuple(v) if isinstance(v, list | np.ndarray) else v for key, v in given.items()})
            except (TypeError, ValueError) as error:
                raise ScenarioError(f"faults[{i}]: {error}") from None
        found.append(fault)
    return tuple(found)


def _dvfs(value: Any) -> Any:
    law, parameters = value, {}
    if isinstance(value, Mapping):
        parameters = dict(value)
        law = parameters.pop("law", None)
    elif not isinstance(value, str):
        return value
    if not isinstance(law, str) or law not in DVFS_LAWS:
        names = ", ".join(map(repr, DVFS_LAWS))
        raise ScenarioError(f"dvfs is {value!r}; give {names}, or a mapping with the key 'law' that is one of them")
    known = [field.name for field in dataclasses.fields(DVFS_LAWS[law])]
    for key in parameters:
        if key not in known:
            raise ScenarioError(f"dvfs: law {law!r} has no parameter {key!r}; there are {', '.join(known) or 'none'}")
    try:
        return DVFS_LAWS[law](**parameters)
    except ValueError as error:
        raise ScenarioError(f"dvfs: {error}") from None


def _is_there(path: str | Path, kind: Callable[[Path], bool]) -> bool:
    try:
        return kind(Path(path))
    except (OSError, ValueError):  # a name too long, or with a null character
        return False


def _recording(field: str, value: Any) -> Any:
    try:
        return recorded_trace(str(value))
    except (TraceError, OSError) as error:
        raise ScenarioError(f"{field} is {str(value)!r}: {error}") from None


def _names_recording(value: Any) -> bool:
    """Whether a value names a recording, or a file that is there."""
    return isinstance(value, Path) or (
        isinstance(value, str) and (value in RECORDINGS or _is_there(value, Path.is_file))
    )


def _trace(value: Any) -> Any:
    if isinstance(value, PowerTrace):
        return (value,)
    if _names_recording(value):
        return (_recording("trace", value),)
    if isinstance(value, list | tuple):
        named = [isinstance(item, str | Path) and item not in TRACE_SOURCES for item in value]
        return tuple(_recording("trace", v) if is_named else v for v, is_named in zip(value, named, strict=True))
    return value


def _inverter_trace(value: Any) -> Any:
    return _recording("inverter_trace", value) if _names_recording(value) else value


_CONVERSIONS: dict[str, Callable[[Any], Any]] = {
    "feeder": _feeder,
    "faults": _faults,
    "dvfs": _dvfs,
    "trace": _trace,
    "inverter_trace": _inverter_trace,
}
