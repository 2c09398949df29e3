"""Whether a policy was trained on a scenario: on its feeder, with its devices and its step."""

from __future__ import annotations

import shlex
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dcgrid_env import SCENARIO_REGISTRY, RandomFeeders, Scenario
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.tuning.tuned import grid_difference


class UnseenScenarioWarning(UserWarning):
    """A policy drives a scenario whose feeder or devices it was not trained on, and may do much worse than a droop."""


@contextmanager
def on_purpose() -> Iterator[None]:
    """No warnings of unseen scenarios in the block: for studies of what carries over, and for guards against it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnseenScenarioWarning)
        yield


def unseen(trained_on: str, scenario: Scenario) -> str | None:
    """Name of the field in which a scenario's grid differs from all that a policy was trained on; None for none.

    If one of those is on the scenario's feeder, the field in which that one differs.

    Parameters
    ----------
    trained_on
        What the policy says, ``Policy.trained_on``: names of scenarios separated by commas, maybe with ``--set``.
    scenario
        What it is to drive. Load, noise, horizon, cost and split may differ, and a member of random feeders is known to
        a policy that was trained on the family.

    Returns
    -------
    str or None
        None too where nothing is known of what it was trained on: code of the user's own is not run for this.
    """
    try:
        every = trained_scenarios(trained_on)
    except (ValueError, OSError):  # code of the user's own, or a file that has changed since
        return None
    differs = [None if _is_member(scenario, trained) else grid_difference(scenario, trained) for trained in every]
    if not differs or None in differs:
        return None
    return next((field for field in differs if field != "feeder"), "feeder")  # that of the one on its feeder


def trained_scenarios(trained_on: str) -> list[Scenario]:
    """The scenarios that a policy says it was trained on, on the training split; none where it names none.

    ValueError or OSError where one can no longer be made, ValueError too where that would run code of the user's own.
    """
    words = shlex.split(trained_on)
    where, sets = (words[0], tuple(words[2:])) if words[1:2] == ["--set"] else (trained_on, ())
    names = [part.strip() for part in where.split(",") if part.strip()]
    for name in names:
        if name not in SCENARIO_REGISTRY and not (name.endswith(".toml") and Path(name).is_file()):
            raise ValueError(f"policy: it was trained on {name!r}, which is no scenario of a name nor a file of one")
    return [ScenarioSpec(name, sets).make("train") for name in names]


def _is_member(scenario: Scenario, trained: Scenario) -> bool:
    """Whether a scenario is on one of the random feeders of another."""
    family = trained.feeder
    return isinstance(family, RandomFeeders) and scenario.feeder.name.startswith(f"{family.name}-")


def warn_of_unseen(source: str, trained_on: str, scenario: Scenario) -> None:
    """One warning where a policy, called ``source``, is given a scenario that it was not trained on."""
    if differs := unseen(trained_on, scenario):
        warnings.warn(
            f"{source}: trained on {trained_on}, {scenario.name} differs in {differs}; what it reaches there is open: "
            "guarded(policy), or guarded: before its name, keeps it near the droop",
            UnseenScenarioWarning,
            stacklevel=3,
        )
