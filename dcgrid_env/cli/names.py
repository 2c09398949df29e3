"""Read lists of names and scenario overrides from the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

_OPEN, _CLOSED, _QUOTES = "([{", ")]}", "'\""


def split_names(text: str) -> list[str]:
    """Split names at commas, in order and without duplicates; a comma within brackets is part of a name.

    Raises ValueError if a bracket is not closed.
    """
    names, depth, quote = [""], 0, ""
    for sign in text:
        if quote or (depth and sign in _QUOTES):
            quote = "" if sign == quote else quote or sign
        elif sign in _OPEN:
            depth += 1
        elif sign in _CLOSED:
            depth = max(0, depth - 1)
        if sign == "," and not depth:
            names.append("")
        else:
            names[-1] += sign
    if depth:
        raise ValueError(f"names: brackets must be closed, got {text!r}; close the bracket")
    return list(dict.fromkeys(name.strip() for name in names if name.strip()))


def scenario_names(text: str) -> list[str]:
    """Return scenario names, or all presets for ``all``; raise ValueError if a name is unknown or there is none."""
    from dcgrid_env import PRESETS, SCENARIO_REGISTRY

    names = list(PRESETS) if text.strip() == "all" else split_names(text)
    unknown = [name for name in names if name not in SCENARIO_REGISTRY]
    if unknown:
        raise ValueError(SCENARIO_REGISTRY.unknown(unknown[0]))
    if not names:
        raise ValueError(
            f"scenarios: must name at least one scenario, or all, got {text!r}; `dcgrid list scenarios` lists them"
        )
    return names


def one_scenario(text: str) -> str:
    """Return the name of one scenario; raise ValueError if it is unknown or there is not exactly one."""
    names = scenario_names(text)
    if len(names) > 1:
        raise ValueError(f"scenario: must be one name, got {text!r}")
    return names[0]


def scenario_specs(text: str, overrides: tuple[str, ...], split: str) -> dict[str, ScenarioSpec]:
    """Return scenarios with their overrides, by scenario name: presets (``all`` for every preset) or user scenarios.

    Raises ValueError if a scenario is invalid, there is none, or two share a name.
    """
    from dcgrid_env import PRESETS
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

    listed = list(PRESETS) if text.strip() == "all" else split_names(text)
    if not listed:
        raise ValueError(
            f"scenarios: must name at least one scenario, or all, got {text!r}; `dcgrid list scenarios` lists them"
        )
    specs: dict[str, ScenarioSpec] = {}
    for where in listed:
        spec = ScenarioSpec(where, overrides)
        name = spec.make(split).name
        if name in specs:
            raise ValueError(
                f"scenarios: names must differ, got {name!r} for both {specs[name].where} and {where}; rename one, or "
                "run one at a time"
            )
        specs[name] = spec
    return specs
