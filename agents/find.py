"""A controller as the command line names it: one that ships, a class of the user's own, or a saved policy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dcgrid_env import PRESETS, Scenario, make_scenario
from dcgrid_env.agents.policy.policy import SHIPPED, SUFFIX, Policy
from dcgrid_env.baselines import CONTROLLERS, TUNED, Controller, make_controller
from dcgrid_env.baselines.scenario_spec import options_of
from dcgrid_env.baselines.tuning.tuned import grid_difference
from dcgrid_env.baselines.user_code import Named, OwnCodeError, described, load, parse, place

FORMS = (
    "give package.module:Class or path/to/file.py:Class for one of your own, with its arguments in parentheses if it "
    f"takes any, or a saved policy's {SUFFIX} file"
)


def preset_of(policy: str) -> str | None:
    """The preset that a policy's name begins with, the longest such; None where it begins with none."""
    return max((name for name in PRESETS if policy.startswith(f"{name}-")), key=len, default=None)


def _trained(shipped: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Shipped policies by what they are called on every preset: ``PRESET-NAME`` is NAME there."""
    found: dict[str, tuple[str, ...]] = {}
    for policy in shipped:
        if preset := preset_of(policy):
            name = policy.removeprefix(f"{preset}-")
            found[name] = (*found.get(name, ()), preset)
    return found


TRAINED = _trained(SHIPPED)
"""Names that stand for the policy trained on the scenario at hand, with the presets that have one."""
NAMES = (*CONTROLLERS, *TUNED, *TRAINED)
"""All that a benchmark of everything runs; ``SHIPPED`` policies can be named besides."""


def find_controller(spec: str, scenario: Scenario, tuned: str | Path | None = None) -> Controller:
    """A fresh controller for a scenario.

    Parameters
    ----------
    spec
        A name (``NAMES``, ``SHIPPED``); ``package.module:Class`` or ``path/to/file.py:Class``, which runs the user's
        code (modules of the working directory are found too), with literals as arguments if the class takes any,
        ``file.py:Class(gain=0.5)``; or the path of a saved policy, ending in .safetensors (this runs no code).
    scenario
        What it is to drive; tuned controllers look up their gains by it.
    tuned
        A file of ``dcgrid tune`` that the gains must come from, see ``make_controller``.

    Raises
    ------
    ValueError
        For a spec that names nothing, or something that is no controller, or one that has no gains for the scenario;
        an ``OwnCodeError`` where the user's code fails.
    """
    if spec in CONTROLLERS or spec in TUNED:
        return make_controller(spec, scenario, tuned)
    if spec in SHIPPED:
        return Policy.load(spec)
    if spec in TRAINED:
        return Policy.load(_trained_for(spec, scenario))
    if spec.endswith(SUFFIX):
        if not Path(spec).is_file():
            raise ValueError(f"controller {spec!r}: there is no such file; {FORMS}")
        return Policy.load(spec)
    named = parse(spec)
    if named is None:
        raise ValueError(f"unknown controller {spec!r}; there are {', '.join((*NAMES, *SHIPPED))}; or {FORMS}")
    made = _construct(spec, named, load(named, f"controller {spec!r}"))
    if not isinstance(made, Controller):
        raise ValueError(f"controller {spec!r}: {type(made).__name__} is no controller; give it reset and act")
    return made


def _trained_for(name: str, scenario: Scenario) -> str:
    """Name of the shipped policy that a name stands for on a scenario; ValueError where none was trained for it."""
    train = f"train one with `dcgrid train {name} {options_of(scenario, '--scenario')}`"
    if scenario.name not in TRAINED[name]:
        raise ValueError(
            f"controller {name!r}: none ships for {scenario.name!r}, but for {', '.join(TRAINED[name])}; {train}"
        )
    policy = f"{scenario.name}-{name}"
    if differs := grid_difference(scenario, make_scenario(scenario.name)):
        raise ValueError(
            f"controller {name!r}: the policy that ships for {scenario.name!r} was trained on the preset, from which "
            f"this one differs in {differs}; {train}, or name {policy!r} itself to run it all the same"
        )
    return policy


def _construct(spec: str, named: Named, kind: object) -> object:
    if not callable(kind):
        raise ValueError(f"controller {spec!r}: {named.name!r} of {named.where} is no class; {FORMS}")
    try:
        return kind(*named.positional, **dict(named.keywords))
    except (Exception, SystemExit) as error:
        how = "" if named.positional or named.keywords else " without arguments"
        raise OwnCodeError(
            f"controller {spec!r}: constructing it{how} fails{place(error)}: {described(error)}"
        ) from error
