"""Requests of a utility as drawn: ranges, ramps, priorities and what is announced."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcgrid_env import episode_hash, forecast, make_scenario
from dcgrid_env.engine.exogenous.drawn_requests import request_columns
from dcgrid_env.engine.exogenous.episode import draw
from dcgrid_env.scenario.costs.load_requests import columns


def asking(*targets, **overrides):
    """ieee33-weak, three sites of 1 MW, with some requests."""
    return make_scenario("ieee33-weak", grid_request={"targets": list(targets), "notice_s": 10.0}, **overrides)


def over_time(scenario, seed=0, steps=60):
    """The columns of an episode's requests at the steps 0 .. ``steps``, (step,) each."""
    drawn = draw(scenario, np.array([seed], np.uint64), np.zeros(1, np.uint64)).request
    at = np.arange(steps + 1)
    p_ref_kw = np.full((len(at), scenario.n_sites), 500.0)
    found = request_columns(scenario, np.repeat(drawn, len(at), axis=0), at, p_ref_kw)
    return columns(found)


def test_a_cap_with_a_ramp_worked_by_hand():
    found = over_time(asking({"value_share": 0.4, "begin_s": 20, "ramp_s": 4, "duration_s": 10}))
    expected = np.ones(61)
    expected[21:24] = 1.0 - 0.6 * np.array([0.25, 0.5, 0.75])
    expected[24:31] = 0.4
    np.testing.assert_allclose(found.upper, expected, atol=1e-12)
    assert not found.lower.any()
    np.testing.assert_allclose(found.reference, 0.5)
    np.testing.assert_array_equal(found.upper_next[:-1], found.upper[1:])
    np.testing.assert_allclose(found.wait[[9, 10, 15, 19, 20]], [1.0, 1.0, 0.5, 0.1, 1.0])  # 20: it is in force
    np.testing.assert_allclose(found.upper_announced[[9, 10, 19, 20]], [1.0, 0.4, 0.4, 1.0])
    np.testing.assert_allclose(found.left[[19, 20, 25, 29, 30]], [0.0, 1.0, 0.5, 0.1, 0.0])


def test_a_target_in_mw_bounds_both_sides():
    found = over_time(asking({"kind": "target", "value_mw": 1.2, "begin_s": 5, "duration_s": 10}))
    np.testing.assert_allclose((found.lower[6], found.upper[6]), 0.4)
    np.testing.assert_allclose((found.lower[16], found.upper[16]), (0.0, 1.0))
    np.testing.assert_allclose((found.lower_announced[3], found.upper_announced[3]), 0.4)


def test_the_highest_priority_holds_and_among_equals_the_last_to_start():
    first = {"value_share": 0.5, "begin_s": 10, "duration_s": 30}
    second = {"value_share": 0.7, "begin_s": 20, "duration_s": 10}
    equal = over_time(asking(first, second))
    np.testing.assert_allclose(equal.upper[[15, 25, 35, 45]], [0.5, 0.7, 0.5, 1.0])
    urgent = over_time(asking(first | {"priority": 1}, second))
    np.testing.assert_allclose(urgent.upper[[15, 25, 35, 45]], [0.5, 0.5, 0.5, 1.0])
    np.testing.assert_allclose(over_time(asking(second, first)).upper, equal.upper)


def test_without_notice_nothing_is_announced():
    scenario = asking({"value_share": 0.4, "begin_s": 20}).replace(grid_request={"notice_s": 0.0})
    found = over_time(scenario)
    assert (found.wait == 1.0).all()
    assert (found.upper_announced == 1.0).all()
    np.testing.assert_allclose(found.upper_next[[19, 20]], [1.0, 0.4])


def test_an_episode_draws_within_the_ranges_and_nothing_else_changes():
    ranges = {"value_share": [0.3, 0.5], "begin_s": [10, 30], "ramp_s": [0, 5], "duration_s": [20, 40]}
    scenario, plain = asking(ranges), make_scenario("ieee33-weak")
    seeds = np.arange(200, dtype=np.uint64)
    drawn = draw(scenario, seeds, np.zeros_like(seeds)).request[:, 0]
    for column, (low, high) in enumerate(([10, 30], [0, 5], [20, 40], [0.3, 0.5])):
        assert low <= drawn[:, column].min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < drawn[:, column].max() <= high
    found, before = forecast(scenario, 3), forecast(plain, 3)
    for field in before._fields:
        if field != "request":
            np.testing.assert_array_equal(getattr(found, field), getattr(before, field))
    assert before.request is None
    assert found.request is not None
    assert found.request.shape == (scenario.horizon, 2)
    assert episode_hash(scenario, 3) != episode_hash(plain, 3)


requests = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["cap", "target"]),
        "value_share": st.floats(0.0, 1.0, allow_subnormal=False),
        "begin_s": st.floats(0.0, 70.0, allow_subnormal=False),
        "ramp_s": st.floats(0.0, 30.0, allow_subnormal=False),
        "duration_s": st.floats(0.5, 60.0),
        "priority": st.integers(0, 3),
    }
)


@given(st.lists(requests, min_size=1, max_size=4), st.sampled_from([0.1, 1.0, 7.0]))
@pytest.mark.slow
def test_a_request_is_a_range_within_what_sites_can_draw(targets, dt_s):
    found = over_time(asking(*targets, dt_s=dt_s))
    for name, figures in found._asdict().items():
        assert ((figures >= -1e-12) & (figures <= 1.0 + 1e-12)).all(), name
    assert (found.lower <= found.upper + 1e-12).all()
    np.testing.assert_array_equal(found.lower_next[:-1], found.lower[1:])
    np.testing.assert_array_equal(found.upper_next[:-1], found.upper[1:])
    t_s = np.arange(61) * dt_s
    some = np.zeros(61, bool)
    for target in targets:
        begin_s, end_s = target["begin_s"], target["begin_s"] + target["duration_s"]
        some |= (begin_s + 1e-9 < t_s) & (t_s <= end_s + 1e-9)
    assert (found.upper[~some] == 1.0).all()
    assert (found.lower[~some] == 0.0).all()


@pytest.mark.parametrize("dt_s", [0.1, 0.25])
def test_a_shorter_step_finds_the_same_times(dt_s):
    found = over_time(asking({"value_share": 0.4, "begin_s": 2, "duration_s": 3}, dt_s=dt_s), steps=round(8 / dt_s))
    steps = round(2 / dt_s), round(5 / dt_s)
    np.testing.assert_array_equal(np.flatnonzero(found.upper < 1.0), np.arange(steps[0] + 1, steps[1] + 1))
