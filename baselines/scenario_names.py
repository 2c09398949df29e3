"""Scenarios that a command line lists: their names, or specifications with overrides."""

from __future__ import annotations

from dcgrid_env import PRESETS, SCENARIO_REGISTRY
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.core.commands.names import split_names


def scenario_names(text: str) -> list[str]:
    """Return scenario names, or all presets for ``all``; raise ValueError if a name is unknown or there is none."""
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
