"""The default form of rows: what is chosen, what an action of 0 does, and that the form survives copies."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from dcgrid_env import DcgridVectorEnv, make_scenario
from dcgrid_env.agents import sb3_vec_env
from dcgrid_env.baselines import make_controller


@pytest.mark.parametrize(
    ("scenario", "fields", "form", "reward", "default_action"),
    [
        ("ieee33-weak", {}, ("channel", "change", True), "difference", "previous"),
        ("ieee33-weak", {"outputs": "droop"}, ("channel", "droop", True), "difference", "droop"),
        ("smoothing", {}, ("channel", "droop", True), "local", "previous"),  # difference is not defined
        ("ieee13-3ph", {}, ("channel", "droop", True), "local", "previous"),
        ("ieee13-3ph", {"grid_control": {"regulators": "agent"}}, ("joint", "setpoint", False), "shared", "previous"),
        ("ieee123-3ph-day", {}, ("joint", "setpoint", False), "shared", "previous"),
        ("toy6", {"split": "validation"}, ("channel", "change", True), "shared", "previous"),
        ("toy6", {"split": "test"}, ("channel", "change", True), "shared", "previous"),
        # What is given wins.
        ("toy6", {"view": "joint"}, ("joint", "change", False), "shared", "previous"),
        ("toy6", {"view": "shared", "nameplate": False}, ("shared", "change", False), "difference", "previous"),
        ("toy6", {"outputs": "setpoint"}, ("channel", "setpoint", True), "difference", "previous"),
        ("toy6", {"reward": "shared"}, ("channel", "change", True), "shared", "previous"),
        ("toy6", {"cost": {"reward": "shared"}}, ("channel", "change", True), "shared", "previous"),
        ("toy6", {"reward": "difference", "split": "test"}, ("channel", "change", True), "difference", "previous"),
        (
            "toy6",
            {"reward": "difference", "cost": {"default_action": "rest"}},
            ("channel", "change", True),
            "difference",
            "rest",
        ),
    ],
)
def test_what_is_not_given_is_chosen_by_scenario_and_split(scenario, fields, form, reward, default_action):
    made: Any = sb3_vec_env(scenario, 1, **fields)
    chosen = made.action_space.form
    assert (chosen["view"], chosen["outputs"], chosen["nameplate"]) == form
    assert chosen["scenario"] == made.scenario.name
    gains = None if chosen["gains"] is None else tuple(chosen["gains"])
    assert (gains is None) == (form[1] != "droop")
    assert (made.scenario.cost.reward, made.scenario.cost.default_action) == (reward, default_action)
    if default_action == "droop":
        assert made.scenario.cost.default_gains == gains


@pytest.mark.parametrize(
    "scenario", ["ieee33-weak", "ieee13-3ph", "ieee33-weak-ups", "ride-through", "routing", "smoothing"]
)
@pytest.mark.parametrize("view", ["channel", "joint"])
@pytest.mark.parametrize(("outputs", "same_as"), [("droop", "droop-tuned"), ("change", "none")])
@pytest.mark.slow
def test_an_action_of_zero_is_the_droop_or_no_control(scenario, view, outputs, same_as):
    chosen = make_scenario(scenario, split="test", horizon=30)
    made: Any = sb3_vec_env(chosen, 2, view, outputs=outputs, action_repeat=1)
    native, law = DcgridVectorEnv(2, chosen), make_controller(same_as, chosen)
    made.seed(5)
    made.reset()
    law.reset(chosen)
    joint, infos = native.reset(seed=5)
    paid, rest = np.zeros(made.num_envs), np.zeros((made.num_envs, *made.action_space.shape), np.float32)
    ends = []
    for _ in range(30):
        _, reward, _, ends = made.step(rest)
        joint, *_, infos = native.step(law.act(joint))
        paid += reward
        np.testing.assert_allclose(made.batch.transition.observation, native.transition.observation, atol=2e-4)
    j = infos["final_info"]["J"].repeat(made.rows_per_env)
    np.testing.assert_allclose([end["J"] for end in ends], j, rtol=1e-5)
    np.testing.assert_allclose(-paid / 30, j, rtol=1e-5)  # outside of training rows are paid minus the cost


def test_actions_keep_their_form_in_copies_and_differ_by_it():
    made: Any = sb3_vec_env("toy6", 1)
    space = made.action_space
    for same in (copy.deepcopy(space), pickle.loads(pickle.dumps(space))):
        assert same == space
        assert same.form == space.form
        assert same.sample() in space
    assert pickle.loads(pickle.dumps(made.observation_space)) == made.observation_space
    assert space == sb3_vec_env("ieee33-weak", 1).action_space  # so that a model goes on elsewhere
    assert space == spaces.Box(-1.0, 1.0, (1,), np.float32)
    assert space != sb3_vec_env("toy6", 1, outputs="droop").action_space
