"""Policies as controllers that have a name: those that ship, and the names that they have on every preset."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from dcgrid_env import PRESETS, Scenario, make_scenario
from dcgrid_env.agents.from_sb3.sb3_policy import read_policy
from dcgrid_env.agents.from_sb3.sb3_zip import SUFFIX as ZIP
from dcgrid_env.agents.from_sb3.sb3_zip import trained_scenario
from dcgrid_env.agents.policy.guard import GuardedPolicy, guarded, law_for
from dcgrid_env.agents.policy.model_aided_policy import ModelAidedPolicy
from dcgrid_env.agents.policy.policy import SHIPPED, SUFFIX, Policy
from dcgrid_env.agents.policy.trial_guard import TriedPolicy
from dcgrid_env.baselines import Controller, ForScenario
from dcgrid_env.baselines.registry import controller_file, split_prefix
from dcgrid_env.baselines.scenario_spec import options_of
from dcgrid_env.baselines.tuning.tuned import grid_difference
from dcgrid_env.core.plugins import Entry


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
"""Names that select the policy trained on the given scenario, and the presets that have one."""


def _load(name: str, scenario: Scenario, _: str | Path | None) -> Policy:
    return Policy.load(_trained_for(name, scenario))


def _trained_for(name: str, scenario: Scenario) -> str:
    """Return the bundled policy that a name selects on a scenario; raise ValueError if there is none."""
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


def _guarded(controller: Controller, scenario: Scenario, tuned: str | Path | None) -> GuardedPolicy | TriedPolicy:
    """Return a policy under guard; raise ValueError if the controller is not a policy."""
    if not isinstance(controller, Policy):
        raise ValueError(
            f"guarded: it guards learned policies, and this is {type(controller).__name__}; name a policy (dcgrid list)"
        )
    return guarded(controller, None if isinstance(controller, ModelAidedPolicy) else law_for(scenario, tuned))


def trained_on(policy: str) -> str:
    """Return the scenario that a policy was trained on as its file or its name says; empty if there is none.

    Parameters
    ----------
    policy
        Name or file of a controller, see ``find_controller``.
    """
    _, inner = split_prefix(policy)
    file = controller_file(inner)
    if file is not None and file.suffix == ZIP:
        return trained_scenario(file)
    is_policy = inner in SHIPPED or (file is not None and file.suffix == SUFFIX)
    return Policy.load(file or inner).trained_on if is_policy else ""


def without_horizon(trained_on: str) -> str:
    """Return the preset that a training names, without a horizon that alone differs from the preset's."""
    preset, said, rest = trained_on.partition(" --set horizon=")
    return preset if said and rest.isdigit() else trained_on


def _load_file(path: str, scenario: Scenario | None, _: str | Path | None) -> Policy:
    return read_policy(path, scenario)


ENTRIES: dict[str, Entry] = {
    SUFFIX: ("a saved policy", Policy.load),
    ZIP: ForScenario("a model of Stable-Baselines3, of which only weights and text are read", _load_file),
    "guarded:": ("before a policy's name: kept near its law where it was not trained, or does worse", _guarded),
    **{name: (f"the policy {name}, which ships", partial(Policy.load, name)) for name in SHIPPED},
    **{name: ForScenario(f"{name}, trained on the preset that it drives", partial(_load, name)) for name in TRAINED},
}
"""What this room adds to the registry of controllers, through an entry point: policies' names, and their files."""
