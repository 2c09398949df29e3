"""Resets that are given buses and hours instead of drawing them."""

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv

BUSES = np.array([[1, 3, 2], [4, 3, 2]])


def env(**overrides):
    return DcgridVectorEnv(2, "toy6", horizon=3, **overrides)


def test_agents_stand_where_they_are_told_and_draw_there():
    given, drawn = env(background={"load_sigma": 0.0}), env(background={"load_sigma": 0.0})
    given.reset(seed=0, options={"buses": BUSES})
    drawn.reset(seed=0)
    ids = given.scenario.feeder.bus_ids
    assert given.buses().astype(str).tolist() == [[ids[i] for i in row] for row in BUSES]
    assert drawn.buses().tolist() != given.buses().tolist()
    np.testing.assert_array_equal(given.transition.trace_start, drawn.transition.trace_start)
    full = np.array([[1.0, 0.0, 0.0, 0.0]] * 2, np.float32)
    for each in (given, drawn):
        each.step(full)
    v = given.transition.state.v_pu
    assert not np.array_equal(v[0], v[1]), "the site of either environment draws at another bus"


def test_an_environment_begins_at_its_hour():
    given = env(background={"start_hour": "random", "load_sigma": 0.0})
    given.reset(seed=0, options={"begin_h": np.array([4.0, 11.5])})
    low, high = given.transition.state.v_pu.min(axis=1)
    assert low > high, "less load at night"
    fixed = env(background={"start_hour": 4.0, "load_sigma": 0.0})
    fixed.reset(seed=0)
    np.testing.assert_array_equal(fixed.transition.state.v_pu[0], given.transition.state.v_pu[0])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"buses": BUSES[:1]}, r"buses must be whole numbers in 1 to 5, positions in bus_ids, of shape \(2, 3\)"),
        ({"buses": BUSES - 1}, "buses must be whole numbers in 1 to 5"),
        ({"buses": BUSES + 3}, "buses must be whole numbers in 1 to 5"),
        ({"buses": BUSES + 0.5}, "buses must be whole numbers in 1 to 5"),
        ({"begin_h": [1.0, 24.0]}, r"begin_h must be hours from 0 to less than 24, of shape \(2,\)"),
        ({"begin_h": [1.0]}, "begin_h must be hours"),
        ({"begin_h": [1.0, 2.0]}, "the scenario does not follow the day; give background.start_hour"),
        ({"buses": BUSES, "reset_mask": np.array([True, False])}, "give one or the other"),
    ],
)
def test_what_cannot_be_given_is_refused(options, said):
    own = env()
    own.reset(seed=0)
    with pytest.raises(ValueError, match=said):
        own.reset(seed=0, options=options)
