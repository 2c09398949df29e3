"""Scenario files: a scenario as TOML, whole or as what differs from a preset.

    base = "ieee33-weak"
    horizon = 60
    feeder = "ieee33"               # a bundled feeder's name, or a folder relative to this file

    [sensing]
    noise_pu = 0.005

    [[devices]]                     # where one group of devices is given, all of them are
    kind = "datacenter"
    count = 2
    buses = ["18", "33"]
    p_rated_kw = 800.0
    s_rated_share = 1.02
    q_max_share = 0.33

Fields and parts are those of ``Scenario``. ``[datacenters]`` and ``[inverters]`` change fields of these groups.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import MISSING
from pathlib import Path
from typing import Any

from dcgrid_env.core.checked import Plain
from dcgrid_env.core.files import write_text
from dcgrid_env.core.user_files import read_toml as read_toml_file
from dcgrid_env.devices import device_kind
from dcgrid_env.grid import FEEDER_REGISTRY
from dcgrid_env.scenario.assembly import PARTS, with_overrides
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.serialization import PATHS, refuse_objects, to_data

SUFFIX = ".toml"
"""Ending of a scenario file's name."""


def read_toml(path: str | Path, preset: Callable[[str], Any], new: Callable[..., Any]) -> Any:
    """Read a scenario file.

    Parameters
    ----------
    path
        Path of the file; relative paths in it start at its folder.
    preset, new
        Functions that return the scenario named by ``base``, and that make one without a base (the class).

    Raises
    ------
    ScenarioError
        For a missing file, invalid TOML or an invalid field; the message names file, field, value and remedy.
    """
    path = Path(path)
    try:
        data = read_toml_file(path, ScenarioError)
    except (FileNotFoundError, IsADirectoryError):
        what = "a folder" if path.is_dir() else "no file"
        raise ScenarioError(f"{path} is {what}; give a scenario file, see Scenario.to_toml") from None
    except OSError as error:
        raise ScenarioError(f"{path}: {error}") from None
    base = data.pop("base", None)
    if base is not None and not isinstance(base, str):
        raise ScenarioError(f"{path}: base is {base!r}; give the name of a preset")
    if base is None and "feeder" not in data:
        has = f"has {', '.join(data)}, but neither" if data else "is empty: it has neither"
        raise ScenarioError(f"{path} {has} base nor feeder; give base, a preset's name, or all fields of a scenario")
    data = {name: _swapped(_from_here(path.parent, name, value), NONE, None) for name, value in data.items()}
    try:
        if base is None:
            return new(**{"name": path.stem, **data})
        return with_overrides(preset(base), {"name": path.stem, **data})
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{path}: {error}") from None


def to_toml(scenario: Any, path: str | Path | None = None, base: Any = None, brief: bool = False) -> str:
    """Return a scenario as TOML, and write it to a file if a path is given.

    A custom feeder is named by its folder: relative to the file's folder if it is below it, else absolute.

    Parameters
    ----------
    scenario, path
        The scenario, and the file to write.
    base
        A preset: only what differs from it is written, with its name as ``base``.
    brief
        Whether to leave out fields at their default if no base is given.

    Raises
    ------
    ScenarioError
        For a recording, a feeder or a clock law that exists only in memory (use files or names instead), and for a
        base that is not a preset returned by ``make_scenario``.
    """
    import tomli_w  # for who writes alone

    preset = getattr(base, "preset", None)
    if base is not None and preset is None:
        called = f"a variant of {base.name!r}" if hasattr(base, "name") else repr(base)
        raise ScenarioError(
            f"scenario {scenario.name!r}: base is {called}; give a preset as make_scenario(name) gives it"
        )
    data = {field.name: to_data(getattr(scenario, field.name)) for field in dataclasses.fields(scenario)}
    before: dict[str, Any] = {"faults": [], "sags": []}
    if base is not None:
        before = {name: to_data(getattr(base, name)) for name in data if name != "name"}
        if data["feeder"] != before["feeder"]:
            del before["source_voltage_pu"]  # a feeder may bring its own
    elif brief:
        before = _defaults(type(scenario)) | {part: to_data(kind()) for part, kind in PARTS.items()}
        data["devices"] = [_without(group, _defaults(device_kind(group["kind"]))) for group in data["devices"]]
    data = _without(data, before)
    for name in PARTS.keys() & data:
        data[name] = _without(data[name], before.get(name, {}))
    for name, value in data.items():
        refuse_objects(scenario.name, name, value)
    if "feeder" in data and path is not None:
        data["feeder"] = _from_there(Path(path).parent, data["feeder"])
    if "devices" in data:
        data["devices"] = [
            {name: item for name, item in group.items() if item is not None} for group in data["devices"]
        ]
    text = tomli_w.dumps(({} if base is None else {"base": preset}) | _swapped(data, None, NONE))
    if path is not None:
        write_text(Path(path), text)
    return text


def _defaults(kind: type[Any]) -> dict[str, Any]:
    """Return the plain defaults of the fields of a dataclass that have one."""
    fields = dataclasses.fields(kind)
    values = {f.name: f.default_factory() for f in fields if f.default_factory is not MISSING}
    values |= {f.name: f.default for f in fields if f.default is not MISSING}
    return {name: to_data(value) for name, value in values.items()}


def _without(data: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Return the items that another mapping lacks, or has with another value."""
    return {name: value for name, value in data.items() if name not in other or value != other[name]}


def _from_there(folder: Path, feeder: Any) -> Plain:
    """Return a feeder's folder relative to another folder above it; else unchanged."""
    if not isinstance(feeder, str) or feeder in FEEDER_REGISTRY:
        return feeder
    there, folder = Path(feeder).absolute(), folder.absolute()
    return folder_text(there.relative_to(folder).as_posix()) if there.is_relative_to(folder) else feeder


def folder_text(folder: str | Path) -> str:
    """Return a feeder's folder as a text that is not the name of a bundled feeder."""
    return f"./{folder}" if str(folder) in FEEDER_REGISTRY else str(folder)


def _from_here(folder: Path, name: str, value: object) -> Plain:
    """Return paths relative to the folder of the file."""
    name = name.rpartition(".")[2]
    if isinstance(value, dict):
        return {key: _from_here(folder, key, item) for key, item in value.items()}
    if isinstance(value, list) and name in ("devices", "trace"):
        return [_from_here(folder, name, item) for item in value]
    if not isinstance(value, str) or name not in PATHS or value in PATHS[name]:
        return value
    return folder_text(folder / value) if (folder / value).exists() else value


NONE = "none"
"""Text for None, which TOML does not have."""


def _swapped(value: object, old: object, new: object) -> Plain:
    """Return plain data with a value replaced by another."""
    if isinstance(value, dict):
        return {key: _swapped(item, old, new) for key, item in value.items()}
    if isinstance(value, list):
        return [_swapped(item, old, new) for item in value]
    return new if value == old else value
