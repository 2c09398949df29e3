"""Scenarios for which a step's cost determines a difference reward, see ``engine.cost.difference``."""

from __future__ import annotations

from typing import Any

from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.grid.random_feeders.family import RandomFeeders
from dcgrid_env.scenario.costs.grid_terms import TERMS
from dcgrid_env.scenario.errors import ScenarioError

COMPARED = ("voltage", "violation", "effort", "grid_request")
"""Terms of the grid that a default action is compared by."""
UNASSIGNED = ("switching",)
"""Terms of the grid that are not compared, because they follow from timers over many steps. Taps that save more than
their price are paid in advance (``engine.cost.tap_credit``)."""
LATER = ("smoothing", "batching", "cooling")
"""Features of devices whose effect is mostly on later steps."""
MOST_NODES = 2000
"""Largest feeder: the sensitivities of all pairs of nodes are stored."""


def check_difference_reward(scenario: Any) -> None:
    """Raise ScenarioError with the field's name unless a difference reward is defined for the scenario."""
    instead = "use reward='shared' or 'local' there"
    where = f"scenario {scenario.name!r}: cost.reward is 'difference', which"
    feeder, cost = scenario.feeder, scenario.cost
    if isinstance(feeder, RandomFeeders) and cost.reference == "profile":
        raise ScenarioError(f"{where} has one target for all feeders: set cost.reference to 'nominal', or {instead}")
    if feeder.n_node > MOST_NODES:
        raise ScenarioError(f"{where} needs a feeder of {MOST_NODES} nodes at most, not {feeder.n_node}; {instead}")
    for device in scenario.devices:
        if is_equipment(device) and device.channels:
            remedy = f"give under_own_control(scenario), or {instead}"
            raise ScenarioError(f"{where} compares powers, and agents of kind {device.kind!r} have none; {remedy}")
        for field in LATER:
            if device.count and getattr(device, field, None) is not None:
                raise ScenarioError(
                    f"{where} compares single steps, and {field} of kind {device.kind!r} acts on later ones; {instead}"
                )
        if device.changes_grid and not is_equipment(device):
            raise ScenarioError(
                f"{where} compares powers, and devices of kind {device.kind!r} change the grid; {instead}"
            )
    for term in TERMS:
        weight = getattr(cost.weights, term.name)
        if weight and term.amount is not None and term.name not in COMPARED + UNASSIGNED:
            raise ScenarioError(
                f"{where} does not compare what weights.{term.name} = {weight:g} charges; set it to 0, or {instead}"
            )
