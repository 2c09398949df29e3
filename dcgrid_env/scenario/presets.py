"""Scenarios by name, bundled or from other packages, and from files, objects and plain data."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from dcgrid_env.core.plugins import Entry, Registry
from dcgrid_env.scenario.assembly import refuse_deep, with_overrides
from dcgrid_env.scenario.errors import ScenarioError
from dcgrid_env.scenario.preset_table import TABLE, Preset
from dcgrid_env.scenario.scenario import Scenario
from dcgrid_env.scenario.serialization import reads_files
from dcgrid_env.scenario.toml import SUFFIX, read_toml

PRESETS: dict[str, str] = {preset.name: preset.about for preset in TABLE}
"""Description of each preset, by its name."""
IDS: dict[str, str] = {preset.gym_id: preset.name for preset in TABLE}
"""Registered ids, for Gymnasium and, where its release has a registry, for PettingZoo, and their scenarios."""


def _made(preset: Preset) -> Scenario:
    if preset.base is None:
        return Scenario(name=preset.name, **preset.fields)
    return _preset(preset.base).replace(name=preset.name, **preset.fields)


ENTRIES: dict[str, Entry] = {preset.name: (preset.about, partial(_made, preset)) for preset in TABLE}
"""The presets as entries of the registry."""
SCENARIO_REGISTRY = Registry("dcgrid.scenarios", "scenario", Scenario, ENTRIES)
"""All named scenarios, including those of other packages."""


_ALIVE: WeakValueDictionary[Any, Scenario] = WeakValueDictionary()
"""Scenarios with overrides that are still referenced, by the arguments that made them."""


def make_scenario(scenario: str | Path | Scenario | Mapping[str, Any], **overrides: object) -> Scenario:
    """Make a scenario from a name, a file (``my.toml``), a scenario or plain data, and override some fields.

    A name is one of ``PRESETS``, or of another package's entry points ``dcgrid.scenarios``.

    Overrides are objects or plain data (``scenario.serialization``); ``feeder`` may be a name or a folder. A feeder
    that is not bundled brings its source voltage along unless ``source_voltage_pu`` is set too. While the frozen
    scenario is referenced, the same call returns the same object, so equal environments share derived data.

    Raises
    ------
    ScenarioError
        For an unknown scenario (the message lists similar ones) or an invalid value.
    PluginError
        If another package's scenario cannot be made.
    TypeError
        For an override that is not a field.
    """
    if isinstance(scenario, Path) or (isinstance(scenario, str) and scenario.endswith(SUFFIX)):
        base = read_toml(scenario, make_scenario, Scenario)
    elif isinstance(scenario, str):
        base = _preset(scenario)
    elif isinstance(scenario, Scenario):
        base = scenario
    elif isinstance(scenario, Mapping):
        base = Scenario(**scenario)
    else:
        raise ScenarioError(f"scenario is {scenario!r}; give a name ({', '.join(PRESETS)}) or a Scenario")
    if not overrides:
        return base
    refuse_deep(overrides)
    try:
        key = (base, *((name, _key(value)) for name, value in overrides.items()))
        kept = _ALIVE.get(key)
    except TypeError:  # an override that cannot be a key
        return with_overrides(base, overrides)
    if kept is None:
        kept = with_overrides(base, overrides)
        if not any(reads_files(name, value) for name, value in overrides.items()):
            _ALIVE[key] = kept
    return kept


@cache
def _preset(name: str) -> Scenario:
    if name not in SCENARIO_REGISTRY:
        raise ScenarioError(SCENARIO_REGISTRY.unknown(name))
    made = SCENARIO_REGISTRY.make(name)
    made.__dict__.setdefault("_preset", name)
    return made


def _key(value: object) -> Any:
    """Return a hashable form in which equal values of different types differ, such as 1, 1.0 and True."""
    if isinstance(value, Mapping):
        return dict, tuple((key, _key(item)) for key, item in value.items())
    return type(value), tuple(map(_key, value)) if isinstance(value, list | tuple) else value
