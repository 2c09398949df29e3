"""What the study of forecasts measures with: one-step control as it is, and knowledge that is worth something."""

import pytest

from dcgrid_env import make_scenario
from dcgrid_env.baselines import make_controller
from docs.studies.laws import forecasts


@pytest.mark.slow
def test_better_knowledge_of_the_next_second_is_worth_something():
    cost, informed, seeds = forecasts.cost, forecasts.Informed, range(6)
    scenario = make_scenario("mixed", split="validation", horizon=30)
    plain = cost(scenario, make_controller("mpc-one-step", scenario), seeds)
    assert cost(scenario, informed("stay", "stays", seeds), seeds) == pytest.approx(plain, rel=1e-9)
    guessed, known = (cost(scenario, informed("stay", pv, seeds), seeds) for pv in ("goes on as it moved", "known"))
    assert known < guessed < plain
    toy = make_scenario("toy6", split="validation")
    stay, mean, known = (cost(toy, informed(loads, "stays", seeds), seeds) for loads in forecasts.LOADS)
    assert known < mean < stay
