"""Functions from rows to actions as controllers."""

import subprocess
import sys

import numpy as np
import pytest

import dcgrid_env
from dcgrid_env import DcgridEnv, DcgridVectorEnv, action_layout, make_scenario, parallel_env
from dcgrid_env.agents import RowPolicy, sb3_vec_env, training_env
from dcgrid_env.baselines import Controller, rollout
from dcgrid_env.baselines.rollout import ControllerError

SCENARIO = "toy6"


def bent(n_action):
    """Return a function of rows that uses every entry of an observation."""

    def function(rows):
        assert rows.dtype == np.float32
        return np.sin(np.arange(1, n_action + 1) * rows.sum(1, keepdims=True))

    return function


@pytest.mark.parametrize(
    ("view", "form"),
    [
        (None, {}),
        ("channel", {"outputs": "setpoint", "nameplate": False}),
        ("shared", {"outputs": "change"}),
        ("joint", {"outputs": "droop"}),
    ],
)
def test_actions_are_those_of_the_rows_of_training(view, form):
    envs = sb3_vec_env(SCENARIO, 3, view, horizon=4, split="test", **form)
    function = bent(envs.action_space.shape[0])  # pyright: ignore[reportOptionalSubscript]
    policy, scenario = RowPolicy(function, view, **form), make_scenario(SCENARIO, horizon=4, split="test")
    assert isinstance(policy, Controller)
    native = DcgridVectorEnv(3, scenario)
    envs.seed(5)
    rows, (joint, _) = envs.reset(), native.reset(seed=5)
    policy.reset(scenario)
    for _ in range(3):
        rows, *_ = envs.step(function(np.asarray(rows)).astype(np.float32))
        joint, *_ = native.step(policy.act(joint))
        np.testing.assert_array_equal(joint, envs.batch.transition.observation)


def test_one_environment_and_a_mapping_of_agents():
    scenario, policy = make_scenario(SCENARIO, split="test"), RowPolicy(bent(1))
    policy.reset(scenario)
    single, many = DcgridEnv(scenario), parallel_env(scenario)
    action, actions = policy.act(single.reset(seed=0)[0]), policy.act(many.reset(seed=0)[0])
    np.testing.assert_array_equal(action, np.concatenate([actions[agent] for agent in scenario.agents]))


@pytest.mark.slow
@pytest.mark.parametrize("view", ["channel", "joint"])
def test_regulators_are_under_own_control_unless_a_row_is_an_environment(view):
    scenario = make_scenario("ieee13-3ph", horizon=3, split="test", grid_control={"regulators": "agent"})
    seen = []

    def function(rows):
        seen.append(rows.shape)
        return np.zeros((len(rows), scenario_rows(scenario, view)), np.float32)

    rollout(scenario, RowPolicy(function, view, outputs="change"), range(2))
    assert len(seen) == 3


def scenario_rows(scenario, view):
    return action_layout(scenario).n if view == "joint" else 1


def test_what_a_function_returns_is_checked():
    with pytest.raises(ControllerError, match=r"function: returned actions of shape \(8,\); return \(8, 1\)"):
        rollout(make_scenario(SCENARIO, split="test"), RowPolicy(lambda rows: np.zeros(len(rows))), range(2))
    assert dcgrid_env.score(RowPolicy(lambda rows: 5.0 + bent(1)(rows)), SCENARIO, range(2)).J.shape == (2,)  # is cut


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ({"view": "agent"}, "view is 'agent'; choose one of joint, shared, channel"),
        ({"outputs": "torque"}, "outputs is 'torque'; choose one of setpoint, change, droop"),
        ({"nameplate": 1}, "nameplate is 1; choose one of True, False"),
        ({"view": "joint", "nameplate": True}, "nameplate is True with view 'joint'"),
    ],
)
def test_an_unknown_form_is_refused(form, said):
    for make in (lambda: RowPolicy(bent(1), **form), lambda: training_env(SCENARIO, 1, **form)):
        with pytest.raises(ValueError, match=said):
            make()
    with pytest.raises(TypeError, match="function is of type int; give a function of rows"):
        RowPolicy(3)  # pyright: ignore[reportArgumentType]


def test_neither_torch_nor_stable_baselines3_is_needed():
    code = (
        "import sys; sys.modules['stable_baselines3'] = None; import dcgrid_env\n"
        "from dcgrid_env.agents import RowPolicy\n"
        "policy = RowPolicy(lambda rows: 0.0 * rows[:, :1], outputs='droop')\n"
        "print(dcgrid_env.score(policy, 'toy6', range(2)), 'torch' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "score 0.000" in run.stdout
    assert run.stdout.endswith("False\n")
