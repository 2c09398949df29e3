"""The search of set points: no neighbouring offset is better, and the start is never kept if one is."""

import pytest

from docs.studies.laws import coordination
from docs.studies.laws.coordination import coordinated, mean_cost, with_offsets


@pytest.mark.slow
def test_no_move_of_a_regulator_lowers_the_cost_of_what_was_found(monkeypatch):
    monkeypatch.setattr(coordination, "STEPS_V", (2.0,))
    monkeypatch.setattr(coordination, "EPISODES", 2)
    found = coordinated("ieee13-3ph")
    least = mean_cost("ieee13-3ph", found, episodes=2)
    assert least < mean_cost("ieee13-3ph", dict.fromkeys(found, 0.0), episodes=2) - 0.5
    for regulator, offset_v in found.items():
        for moved_v in (offset_v - 2.0, offset_v + 2.0):
            if abs(moved_v) <= coordination.FARTHEST_V:
                assert mean_cost("ieee13-3ph", found | {regulator: moved_v}, episodes=2) >= least


def test_it_searches_on_validation_with_timers_that_integrate():
    scenario = with_offsets("ieee13-3ph", {"reg1": -2.0})
    assert scenario.split == "validation"
    assert scenario.grid_control.regulator_settings.timer == "integrating"
