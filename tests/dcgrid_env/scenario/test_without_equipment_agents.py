"""Scenarios whose regulators and capacitor banks are not agents any more."""

import numpy as np
import pytest

from dcgrid_env import field_names, under_own_control
from dcgrid_env.baselines import make_controller, rollout
from helpers.three_phase import ieee13


def test_the_other_agents_and_what_they_observe_stay():
    scenario = ieee13().replace(grid_control={"regulators": "agent", "capacitors": "agent"})
    plain = under_own_control(scenario)
    names = field_names(scenario)
    assert plain.agents == ieee13().agents == scenario.agents[:6]
    assert field_names(plain) == {agent: names[agent] for agent in plain.agents}


def test_banks_that_are_no_agents_keep_who_decides_over_them():
    scenario = ieee13().replace(
        grid_control={"regulators": "fixed", "capacitors": {"cap1": "agent", "cap2": "controlled"}}
    )
    plain = under_own_control(scenario)
    assert plain.grid_control.regulators == "fixed"
    assert plain.grid_control.capacitors == (("cap1", "fixed"), ("cap2", "controlled"))


def test_agents_of_set_points_leave_the_control_with_its_set_points():
    modes = {"regulators": "setpoint", "capacitors": {"cap1": "setpoint", "cap2": "agent"}}
    scenario = ieee13().replace(grid_control=modes | {"regulator_settings": {"timer": "reset", "offset_v": 1.0}})
    plain = under_own_control(scenario)
    assert plain.agents == ieee13().agents
    assert (plain.grid_control.regulators, plain.grid_control.capacitors) == (
        "controlled",
        (("cap1", "controlled"), ("cap2", "fixed")),
    )
    assert plain.grid_control.regulator_settings == scenario.grid_control.regulator_settings


@pytest.mark.parametrize("banks", ["fixed", "agent"])
def test_a_move_costs_what_it_cost(banks):
    heavy = {
        "datacenters.p_rated_kw": 1500.0,
        "trace": "step",
        "workload.window": "start",
        "background.load_sigma": 0.0,
    }
    scenario = ieee13().replace(
        **{"grid_control.regulators": "agent", "grid_control.capacitors": banks},
        weights={"switching": 10.0},
        horizon=60,
        **heavy,
    )
    prices = []
    for each in (scenario, under_own_control(scenario)):
        (metrics,) = rollout(each, make_controller("droop-q"), [0]).metrics()
        assert metrics["tap_moves"] >= 3.0
        prices.append(metrics["cost_switching"] / metrics["tap_moves"])
    np.testing.assert_allclose(prices[1], prices[0], rtol=1e-12)


def test_a_scenario_without_such_agents_is_returned_as_it_is():
    assert under_own_control(ieee13()) is ieee13()
