"""The search of set points: on validation with timers that integrate; its offsets lower the cost of test episodes."""

import pytest

from dcgrid_env.baselines.tuning import search
from docs.studies import coordination
from docs.studies.coordination import coordinated, costs_of, mean_cost, with_offsets


def test_offsets_lower_the_cost_of_no_control_in_test_episodes(monkeypatch, capsys):
    monkeypatch.setattr(search, "CANDIDATES", 12)
    monkeypatch.setattr(search, "ITERATIONS", 5)
    monkeypatch.setattr(coordination, "EPISODES", 2)
    monkeypatch.setattr(coordination, "TEST_EPISODES", 2)
    monkeypatch.setattr(coordination, "SHOWN", ("none",))
    found = coordinated("ieee13-3ph")
    costs = costs_of("ieee13-3ph")
    assert costs["coordinated"] == [pytest.approx(mean_cost("ieee13-3ph", found, "none"))]
    assert costs["coordinated"][0] < costs["published"][0] - 0.5
    assert f"ieee13-3ph {found}" in capsys.readouterr().out


def test_it_searches_on_validation_with_timers_that_integrate():
    scenario = with_offsets("ieee13-3ph", {"reg1": -2.0})
    assert scenario.split == "validation"
    assert scenario.grid_control.regulator_settings.timer == "integrating"
