"""Refusals of the forecast. The tests of hindsight check that it equals the draws of the environments."""

import pytest

from dcgrid_env import Scenario, ScenarioError, forecast, make_scenario


@pytest.mark.parametrize("scenario", [None, "toy6", 3.5, Scenario])
def test_what_is_no_scenario(scenario):
    with pytest.raises(ScenarioError, match=r"scenario is .*; give a Scenario, for instance make_scenario"):
        forecast(scenario, 0)


@pytest.mark.parametrize("seed", [None, "1", 1.0, True, -1, [0]])
def test_seeds_that_are_no_whole_numbers(seed):
    with pytest.raises(ValueError, match=r"seed is .*; give a whole number of at least 0"):
        forecast(make_scenario("toy6", horizon=2), seed)
