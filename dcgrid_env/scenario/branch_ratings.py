"""Whether the feeder knows the ratings of its branches that a scenario asks about."""

from __future__ import annotations

from typing import Any

from dcgrid_env.core.checked import FieldError
from dcgrid_env.powerflow import has_ratings
from dcgrid_env.scenario.costs.grid_terms import TERMS


def check_ratings(scenario: Any) -> None:
    """Raise FieldError for a price on currents, or its observation, on a feeder that knows no rating."""
    if has_ratings(scenario.feeder):
        return
    remedy = (
        f"feeder {scenario.feeder.name!r} knows the rating of no branch; give its branches rating_a, or leave it out"
    )
    for term in TERMS:
        if term.needs == "ratings" and (weight := getattr(scenario.weights, term.name)):
            raise FieldError("Cost", f"weights.{term.name}", weight, remedy)
    if scenario.observe_loading:
        raise FieldError("Sensing", "observe_loading", True, remedy)
