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
from pathlib import Path
from typing import Any

from dcgrid_env.core.checked import Plain
from dcgrid_env.core.files import write_text
from dcgrid_env.core.user_files import read_toml as read_toml_file
from dcgrid_env.devices import device_kind
from dcgrid_env.grid import FEEDER_REGISTRY
from dcgrid_env.scenario.assembly import GROUPS, PARTS, with_overrides
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.serialization import refuse_objects, to_data

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
        given = read_toml_file(path, ScenarioError)
    except (FileNotFoundError, IsADirectoryError):
        what = "a folder" if path.is_dir() else "no file"
        raise ScenarioError(f"{path} is {what}; give a scenario file, see Scenario.to_toml") from None
    except OSError as error:
        raise ScenarioError(f"{path}: {error}") from None
    base = given.pop("base", None)
    if base is not None and not isinstance(base, str):
        raise ScenarioError(f"{path}: base is {base!r}; give the name of a preset")
    given = {name: _from_here(path.parent, name, value) for name, value in given.items()}
    if base is None and "feeder" not in given:
        has = f"has {', '.join(given)}, but neither" if given else "is empty: it has neither"
        raise ScenarioError(f"{path} {has} base nor feeder; give base, a preset's name, or all fields of a scenario")
    tables = (*PARTS, *GROUPS, "devices", "faults", "sags")  # a text where a table is to be is told as it stands
    given = {name: value if value == NONE and name in tables else _none_in(value) for name, value in given.items()}
    try:
        if base is None:
            return new(**{"name": path.stem, **given})
        return with_overrides(preset(base), {"name": path.stem, **given})
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
    table: dict[str, Any] = {} if base is None else {"base": preset}
    tables: dict[str, Any] = {}
    for field in dataclasses.fields(scenario):
        plain = to_data(getattr(scenario, field.name))
        if base is not None:
            before = to_data(getattr(base, field.name))
            on_other = field.name == "source_voltage_pu" and "feeder" in table  # which would bring its own
            if field.name != "name" and plain == before and not on_other:
                continue
            if field.name in PARTS:
                plain = {name: now for name, now in plain.items() if now != before[name]}
        refuse_objects(scenario.name, field.name, plain)
        if brief and base is None:
            plain = _without_defaults(field, plain)
            if plain is _DEFAULT:
                continue
        if field.name == "feeder" and path is not None:
            plain = _from_there(Path(path).parent, plain)
        if field.name == "devices":
            plain = [{name: item for name, item in device.items() if item is not None} for device in plain]
        (tables if field.name in (*PARTS, "devices", "faults", "sags") else table)[field.name] = _without_none(plain)
    text = tomli_w.dumps(table | {name: item for name, item in tables.items() if item or base is not None})
    if path is not None:
        write_text(Path(path), text)
    return text


_DEFAULT = object()


def _without_defaults(field: dataclasses.Field[Any], plain: Plain) -> Plain:
    """Return the plain form of a field without parts at their default; ``_DEFAULT`` if nothing is left."""
    if field.name == "devices":
        return [{"kind": group["kind"], **_changed(device_kind(group["kind"]), group)} for group in plain]
    if field.name in PARTS:
        return _changed(PARTS[field.name], plain)
    return _DEFAULT if field.default is not dataclasses.MISSING and plain == to_data(field.default) else plain


def _changed(kind: type[Any], plain: dict[str, Any]) -> dict[str, Any]:
    """Return the plain fields of a part or a group of devices that are not at their defaults."""
    changed: dict[str, Any] = {}
    for field in dataclasses.fields(kind):
        default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        if field.name in plain and plain[field.name] != to_data(default):
            changed[field.name] = plain[field.name]
    return changed


def _from_there(folder: Path, feeder: Any) -> Plain:
    """Return a feeder's folder relative to another folder above it; else unchanged."""
    if not isinstance(feeder, str) or feeder in FEEDER_REGISTRY:
        return feeder
    there, folder = Path(feeder).absolute(), folder.absolute()
    if not there.is_relative_to(folder):
        return feeder
    below = there.relative_to(folder).as_posix()
    return folder_text(below)


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
    if name == "feeder" and isinstance(value, str) and value in FEEDER_REGISTRY:
        return value
    if isinstance(value, str) and name in ("feeder", "trace", "injection", "file", "classes"):
        there = folder / value
        return (folder_text(there) if name == "feeder" else str(there)) if there.exists() else value
    return value


NONE = "none"
"""Text for None, which TOML does not have."""


def _none_in(value: object) -> Plain:
    if isinstance(value, dict):
        return {key: _none_in(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_none_in(item) for item in value]
    return None if value == NONE else value


def _without_none(value: object) -> Plain:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_none(item) for item in value]
    return NONE if value is None else value
