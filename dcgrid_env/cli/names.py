"""Names as the command line takes them: lists with commas, and scenarios with other values for some fields."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

_OPEN, _CLOSED, _QUOTES = "([{", ")]}", "'\""


def split_names(text: str) -> list[str]:
    """Names separated by commas, each once, in order; a comma within brackets is part of a name.

    ValueError where a bracket is not closed.
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
        raise ValueError(f"{text!r} opens a bracket and does not close it; close it (a path may hold none)")
    return list(dict.fromkeys(name.strip() for name in names if name.strip()))


def scenario_names(text: str) -> list[str]:
    """Names of scenarios, or those of all presets for ``all``; ValueError for one that does not exist, or none."""
    from dcgrid_env import PRESETS, SCENARIO_REGISTRY

    names = list(PRESETS) if text.strip() == "all" else split_names(text)
    unknown = [name for name in names if name not in SCENARIO_REGISTRY]
    if unknown:
        raise ValueError(SCENARIO_REGISTRY.unknown(unknown[0]))
    if not names:
        raise ValueError(f"scenarios is {text!r}; name at least one, or all (dcgrid list)")
    return names


def one_scenario(text: str) -> str:
    """The name of one scenario; ValueError for one that does not exist, none or several."""
    names = scenario_names(text)
    if len(names) > 1:
        raise ValueError(f"scenario is {text!r}; give one")
    return names[0]


def scenario_specs(text: str, overrides: tuple[str, ...], split: str) -> dict[str, ScenarioSpec]:
    """Scenarios by their own names: presets, all of them for ``all``, or the user's, each with the overrides.

    ValueError for one that cannot be, none, or two of one name, which could not be told apart in what is written.
    """
    from dcgrid_env import PRESETS
    from dcgrid_env.baselines.scenario_spec import ScenarioSpec

    listed = list(PRESETS) if text.strip() == "all" else split_names(text)
    if not listed:
        raise ValueError(f"scenarios is {text!r}; name at least one, or all (dcgrid list)")
    specs: dict[str, ScenarioSpec] = {}
    for where in listed:
        spec = ScenarioSpec(where, overrides)
        name = spec.make(split).name
        if name in specs:
            raise ValueError(
                f"scenarios: {specs[name].where} and {where} are both called {name!r}; give each a name of its own, or "
                "run one at a time"
            )
        specs[name] = spec
    return specs
