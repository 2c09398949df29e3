"""Errors in a controller become one error that names it."""

import numpy as np
import pytest
import torch

from dcgrid_env import make_scenario
from dcgrid_env.baselines import ConstantQ, make_controller, rollout
from dcgrid_env.baselines.rollout import ControllerError

TOY6 = make_scenario("toy6", horizon=3)


class Still:
    """Returns what it was made with for each environment."""

    def __init__(self, action=None, fails_in=""):
        self.action, self.fails_in = action, fails_in

    def reset(self, env_info):
        if self.fails_in == "reset":
            {}["k"]

    def act(self, observations):
        if self.fails_in == "act":
            raise KeyError("k")
        return self.action


@pytest.mark.parametrize("during", ["reset", "act"])
def test_an_error_names_the_controller_its_file_and_line(during):
    with pytest.raises(
        ControllerError, match=rf"^controller 'Still' fails in {during}, test_rollout.py line \d+: KeyError: 'k'$"
    ) as raised:
        rollout(TOY6, Still(fails_in=during), [0])
    assert isinstance(raised.value.__cause__, KeyError)
    assert isinstance(raised.value, ValueError)
    with pytest.raises(ControllerError, match=r"^controller 'own\.py:C' fails"):
        rollout(TOY6, Still(fails_in=during), [0], name="own.py:C")


def test_a_refusal_says_of_what():
    with pytest.raises(
        ControllerError, match=r"^controller 'ConstantQ' cannot drive toy6: constant-q: q_share has 2 sh"
    ):
        rollout(TOY6, ConstantQ((0.1, 0.2)), [0])


@pytest.mark.parametrize(
    "action",
    [
        torch.full((2, 4), 0.5),
        torch.full((2, 4), 0.5, dtype=torch.float64),
        torch.full((2, 4), 0.5, requires_grad=True).detach(),
        [[0.5] * 4] * 2,
        np.full((2, 4), 0.5, dtype=np.float16),
    ],
)
def test_tensors_and_lists_are_actions(action):
    expected = rollout(TOY6, Still(np.full((2, 4), 0.5)), [0, 1]).costs()
    np.testing.assert_array_equal(rollout(TOY6, Still(action), [0, 1]).costs(), expected)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (torch.full((2, 4), 0.5, requires_grad=True), r"records gradients.* return action\.detach\(\)"),
        (torch.full((2, 3), 0.5), r"the action has shape \(2, 3\); it must be \(2, 4\): dc_0 clock"),
        (torch.full((2, 4), torch.nan), "action of dc_0: clock is nan in environment 0"),
        (np.full((2, 4), 0.5j), "the action is complex; give real numbers"),
        (None, "act returned None; return the action"),
        ("x", "the action is no array of numbers"),
        ({"dc_0": [1, 0]}, "the action is no array of numbers"),
        ([[0.5], [0.5] * 4], "the action is no array of numbers"),
    ],
)
def test_what_is_no_action(action, message):
    with pytest.raises(ControllerError, match=f"^controller 'Still' fails in act: .*{message}") as raised:
        rollout(TOY6, Still(action), [0, 1])
    assert len(str(raised.value).splitlines()) == 1


def test_the_reward_of_training_changes_nothing():
    paid = {"reward": "difference", "default_action": "droop", "default_gains": (1.0, 1.0, 1.0)}
    plain, trained_on = (make_scenario("toy6", horizon=5, **fields) for fields in ({}, {"cost": paid}))
    expected, costs = (
        rollout(scenario, make_controller("droop-tuned", plain), range(2)).costs() for scenario in (plain, trained_on)
    )
    np.testing.assert_array_equal(costs, expected)
