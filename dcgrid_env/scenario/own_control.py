"""Regulators and capacitor banks of a scenario without equipment agents."""

from __future__ import annotations

from dcgrid_env.core.cache import cached_on_owner
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.scenario.grid_control import ByBank, Decider, capacitor_deciders, regulator_deciders
from dcgrid_env.scenario.scenario import Scenario


def under_own_control(scenario: Scenario, keep_set_points: bool = False) -> Scenario:
    """Return the scenario with regulator agents replaced by their banks' control, and capacitor agents by fixed banks.

    Agents of set points are replaced by the control with its default set points, unless ``keep_set_points``. The other
    agents see and do the same as before, and a move costs what it cost. A scenario without such agents is returned
    unchanged.
    """
    return _without_agents(scenario, keep_set_points) or scenario


@cached_on_owner
def _without_agents(scenario: Scenario, keep_set_points: bool) -> Scenario | None:
    feeder, control = scenario.feeder, scenario.grid_control
    if not isinstance(feeder, ThreePhaseFeeder):
        return None
    deciders = regulator_deciders(control, feeder), capacitor_deciders(control, feeder)
    kept: dict[Decider, Decider] = {} if keep_set_points else {"setpoint": "controlled"}
    if not any({"agent", *kept} & set(of_kind) for of_kind in deciders):
        return None
    other = scenario.replace(
        grid_control={
            "regulators": _replaced(control.regulators, {"agent": "controlled", **kept}),
            "capacitors": _replaced(control.capacitors, {"agent": "fixed", **kept}),
        }
    )
    left = regulator_deciders(other.grid_control, feeder), capacitor_deciders(other.grid_control, feeder)
    # Switching is charged by the mean over what is not fixed, of which there may now be less.
    switching = scenario.cost.weights.switching * _n_moving(left) / _n_moving(deciders)
    return other.replace(weights=other.cost.weights._replace(switching=switching))


def _replaced(decider: Decider | ByBank, instead: dict[Decider, Decider]) -> Decider | ByBank:
    if isinstance(decider, str):
        return instead.get(decider, decider)
    return tuple((bank, instead.get(by, by)) for bank, by in decider)


def _n_moving(deciders: tuple[tuple[Decider, ...], ...]) -> int:
    return sum(decider != "fixed" for of_kind in deciders for decider in of_kind)
