"""Actions as they come in: joint or one an agent, in order, of the right shape, and finite."""

import numpy as np
import pytest

from dcgrid_env import ActionError, make_scenario
from dcgrid_env.engine.physics.actions import action_layout, joined_actions, joint_action

TOY6 = make_scenario("toy6")
OWN = {"dc_0": [0.1, 0.2], "inv_0": [0.3], "inv_1": [0.4]}


def test_names_are_clock_and_q_of_each_site_then_q_of_each_inverter():
    assert action_layout(TOY6).names == (("dc_0", "clock"), ("dc_0", "q"), ("inv_0", "q"), ("inv_1", "q"))


@pytest.mark.parametrize("n_env", [None, 1, 3])
def test_a_joint_action_comes_back_as_float64_with_its_rows(n_env):
    given = np.arange(4.0 * (n_env or 1), dtype=np.float32).reshape(*([] if n_env is None else [n_env]), 4)
    found = joint_action(TOY6, given, n_env)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, given.reshape(-1, 4))
    assert joint_action(TOY6, given.tolist(), n_env).tolist() == found.tolist()


@pytest.mark.parametrize(
    ("action", "n_env"), [([0.0] * 3, None), ([[0.0] * 4], None), ([0.0] * 4, 1), ([[0.0] * 4], 2)]
)
def test_another_shape_is_refused_with_what_belongs_there(action, n_env):
    want = r"\(4,\)" if n_env is None else rf"\({n_env}, 4\)"
    with pytest.raises(ActionError, match=rf"must be {want}: dc_0 clock, dc_0 q, inv_0 q, inv_1 q"):
        joint_action(TOY6, action, n_env)


@pytest.mark.parametrize("action", [
    "up", [0.0, "x", 0.0, 0.0], [[0.0], [0.0, 0.0]], None, {"dc_0": 1.0}, np.zeros(4, complex), ["0.5"] * 4,
    np.array([0.5, "0.5", 0.5, 0.5], object), np.zeros(4, "m8[s]"),
])  # fmt: skip
def test_what_is_no_array_of_numbers_is_refused(action):
    with pytest.raises(ActionError, match="the action is no array of numbers"):
        joint_action(TOY6, action)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_named(value):
    with pytest.raises(ActionError, match=rf"action of inv_0: q is {value}; give a finite number in \[-1, 1\]"):
        joint_action(TOY6, [0.0, 0.0, value, 0.0])
    action = np.zeros((3, 4))
    action[1, 0] = value
    with pytest.raises(ActionError, match=f"action of dc_0: clock is {value} in environment 1; give"):
        joint_action(TOY6, action, 3)


def test_large_numbers_whose_sum_overflows_are_taken():
    with np.errstate(over="ignore"):
        assert joint_action(TOY6, [1e308] * 4).tolist() == [[1e308] * 4]


def test_one_action_an_agent_in_the_order_of_the_agents():
    assert joined_actions(TOY6, dict(reversed(OWN.items()))).tolist() == [[0.1, 0.2, 0.3, 0.4]]


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"dc_0": [0.0, 0.0], "inv_0": [0.0]}, r"each of \['dc_0', 'inv_0', 'inv_1'\] .* got \['dc_0', 'inv_0'\]"),
        ([0.0] * 4, "must map each of .* got list"),
        (None, "must map each of .* got NoneType"),
        ({**OWN, "inv_3": [0.0], "inv_2": [0.0]}, r"unknown agents \['inv_2', 'inv_3'\]; the agents are \['dc_0', "),
        ({**OWN, "dc_0": [0.0]}, r"action of dc_0 has shape \(1,\); it must be \(2,\)"),
        ({**OWN, "inv_0": [0.0, 0.0]}, r"action of inv_0 has shape \(2,\); it must be \(1,\)"),
        ({**OWN, "inv_1": 0.0}, r"action of inv_1 has shape \(\); it must be \(1,\)"),
        ({**OWN, "inv_1": [np.nan]}, "action of inv_1: q is nan; give"),
    ],
)
def test_actions_of_agents_that_cannot_be_are_named(actions, message):
    with pytest.raises(ActionError, match=message):
        joined_actions(TOY6, actions)
