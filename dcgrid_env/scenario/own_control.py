"""Regulators and capacitor banks of a scenario without equipment agents."""

from __future__ import annotations

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.scenario.grid_control import ByBank, Decider, capacitor_deciders, regulator_deciders
from dcgrid_env.scenario.scenario import Scenario


def under_own_control(scenario: Scenario) -> Scenario:
    """Return the scenario with regulator agents replaced by their banks' control, and capacitor agents by fixed banks.

    Agents of set points are replaced by the control with its set points at rest.
    The other agents see and do the same as before, and a move costs what it cost. A scenario without such agents is
    returned unchanged.
    """
    return _without_agents(scenario) or scenario


@cached_on_owner
def _without_agents(scenario: Scenario) -> Scenario | None:
    feeder, control = scenario.feeder, scenario.grid_control
    if not isinstance(feeder, ThreePhaseFeeder):
        return None
    deciders = regulator_deciders(control, feeder), capacitor_deciders(control, feeder)
    if not any({"agent", "setpoint"} & set(of_kind) for of_kind in deciders):
        return None
    other = scenario.replace(
        grid_control={
            "regulators": _instead(control.regulators, "controlled"),
            "capacitors": _instead(control.capacitors, "fixed"),
        }
    )
    left = regulator_deciders(other.grid_control, feeder), capacitor_deciders(other.grid_control, feeder)
    # Switching is charged by the mean over what is not fixed, of which there may now be less.
    switching = scenario.cost.weights.switching * _n_moving(left) / _n_moving(deciders)
    return other.replace(weights=other.cost.weights._replace(switching=switching))


def _instead(decider: Decider | ByBank, of_agents: Decider) -> Decider | ByBank:
    if isinstance(decider, str):
        return _replaced(decider, of_agents)
    return tuple((bank, _replaced(by, of_agents)) for bank, by in decider)


def _replaced(decider: Decider, of_agents: Decider) -> Decider:
    return {"agent": of_agents, "setpoint": "controlled"}.get(decider, decider)


def _n_moving(deciders: tuple[tuple[Decider, ...], ...]) -> int:
    return sum(decider != "fixed" for of_kind in deciders for decider in of_kind)
