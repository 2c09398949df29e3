"""What a scenario may ask for on the kind of feeder that it has, balanced or three-phase."""

from __future__ import annotations

from typing import Any

from dcgrid_env.core.checked import FieldError, refuse
from dcgrid_env.grid import AnyFeeder, ThreePhaseFeeder
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.costs.grid_terms import TERMS


def check_feeder_kind(scenario: Any) -> None:
    """Raise FieldError for what is no feeder, another kind's power flow, or a cost term that the kind does not have."""
    feeder, weights = scenario.feeder, scenario.weights
    if not isinstance(feeder, AnyFeeder | RandomFeeders):
        raise refuse(scenario, "feeder", "give a feeder, load_feeder(name) or read_feeder(folder), or RandomFeeders")
    balanced = not isinstance(feeder, ThreePhaseFeeder)
    if balanced == (scenario.power_flow == "sweep"):
        methods = "'distflow' or 'lindistflow'" if balanced else "'sweep'"
        kind = "balanced" if balanced else "three-phase"
        raise refuse(scenario, "power_flow", f"give {methods} for the {kind} feeder {feeder.name!r}")
    for term in TERMS:
        weight = getattr(weights, term.name)
        if balanced and weight and term.needs == "three phases":
            remedy = f"set it to 0: the balanced feeder {feeder.name!r} has no such term"
            raise FieldError("Cost", f"weights.{term.name}", weight, remedy)
