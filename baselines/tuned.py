"""Parameters that ship with the package, tuned on the validation split of each preset.

They stand in ``data/tuned.json`` with the command that made them, ``dcgrid tune``.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.tune import TUNABLE

SUFFIX = "-tuned"


@cache
def _shipped() -> dict[str, Any]:
    text = (files("dcgrid_env.baselines.data") / "tuned.json").read_text(encoding="utf-8")
    return json.loads(text)["laws"]


def tuned_parameters(law: str, scenario: str) -> dict[str, Any]:
    """Keyword arguments of a law for a preset; ValueError where none ship, saying how to find them."""
    found = _shipped().get(law, {}).get(scenario)
    if found is None:
        raise ValueError(
            f"no tuned parameters of {law!r} for scenario {scenario!r} ship with the package; find them with "
            f"`dcgrid tune --laws {law} --scenarios {scenario}` or `dcgrid_env.baselines.tune`"
        )
    return {name: tuple(value) if isinstance(value, list) else value for name, value in found["parameters"].items()}


def tuned_controller(law: str, scenario: Scenario) -> Controller:
    """A law with the parameters tuned for the preset of that name; ValueError where none ship."""
    return TUNABLE[law].law(**tuned_parameters(law, scenario.name))
