"""The controllers of a study: as the command line names them, with what a site that is not there yet means for each."""

from __future__ import annotations

from pathlib import Path

from dcgrid_env import Scenario
from dcgrid_env.baselines.controller import Controller
from dcgrid_env.baselines.registry import TUNED, find_controller
from dcgrid_env.baselines.tuning.tunable import TUNABLE
from dcgrid_env.baselines.tuning.tuned import SUFFIX


def study_controller(spec: str, scenario: Scenario, tuned: Path | None) -> tuple[Controller, str]:
    """A fresh controller for a study's scenario, and what is to be said of it, "" for nothing.

    A tuned law has the gains found for the scenario without the added site, which are nobody's if it has none: it then
    has the law's own defaults, and that is said. A controller with a model has one of the feeder with the added site. A
    policy sees what the site's agent observes, whatever it was trained on.

    Raises
    ------
    ValueError
        For what names no controller, and for a tuned law without gains in the file that must have them.
    """
    if spec not in TUNED or tuned is not None:
        return find_controller(spec, scenario, tuned), ""
    try:
        return find_controller(spec, scenario), ""
    except ValueError:
        law = spec.removesuffix(SUFFIX)
        return TUNABLE[law].law(), (
            f"{spec}: no gains are known for this feeder and these devices, so it has the defaults of {law} (dcgrid "
            "tune finds them on a scenario, --scenario and --tuned take them)"
        )
