"""Scores in Python: every form of a policy on the same episodes as the droop and hindsight."""

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import dcgrid_env
from dcgrid_env import make_scenario
from dcgrid_env.agents import Policy, evaluate, find_controller, ppo_settings, sb3_vec_env, to_policy
from dcgrid_env.agents.from_sb3.sb3_policy import read_policy
from dcgrid_env.baselines import published

SCENARIO, SEEDS = "toy6", range(3, 7)


@pytest.fixture(scope="module")
def model():
    envs = VecNormalize(sb3_vec_env(SCENARIO, 2, horizon=4), norm_obs=False)
    return PPO(env=envs, seed=0, **ppo_settings(envs)).learn(64)


def test_a_score_is_that_of_evaluate_and_shows_all_costs_of_its_episodes():
    scenario = make_scenario(SCENARIO, split="test")
    droop, policy = (evaluate(find_controller(name, scenario), scenario, SEEDS) for name in ("droop-tuned", "toy6-ppo"))
    found = dcgrid_env.score("toy6-ppo", SCENARIO, SEEDS)
    assert found.score == policy.score(droop).score
    for figures, expected in ((found.J, policy.J), (found.J_droop, droop.J)):
        np.testing.assert_array_equal(figures, expected)
    costs = published(scenario)
    assert costs is not None
    np.testing.assert_array_equal(found.J_hindsight, costs.select(SEEDS).J)
    assert (found.delay_s, found.violation_pct) == (
        policy.means["delay_mean_s"], policy.means["outside_bus_seconds_pct"],
    )  # fmt: skip
    lines = str(found).splitlines()
    assert [line.split("  ")[0] for line in lines[:4]] == [
        "toy6, test split, 4 episodes", "toy6-ppo", "droop-tuned", "hindsight",
    ]  # fmt: skip
    assert f"{droop.J.mean():.4f}" in lines[2]
    assert lines[4].startswith(f"score {found.score.value:.3f} (95 % interval ")


def test_a_policy_has_one_score_in_every_form(model, tmp_path):
    model.save(tmp_path / "model.zip")
    saved = to_policy(model).save(tmp_path / "policy")
    scores = [
        dcgrid_env.score(policy, make_scenario(SCENARIO), SEEDS).score.value
        for policy in (model, to_policy(model), saved, str(saved), find_controller(str(saved), make_scenario(SCENARIO)))
    ]
    assert scores == pytest.approx([scores[0]] * len(scores), abs=1e-4)
    assert isinstance(to_policy(model, SCENARIO), Policy)
    with pytest.raises(ValueError, match="it was trained behind VecNormalize"):
        read_policy(tmp_path / "model.zip")


@pytest.mark.parametrize(
    ("policy", "scenario", "options", "said"),
    [
        ("none", make_scenario(SCENARIO, horizon=4), {}, "no score: hindsight is published for the test split of"),
        ("none", SCENARIO, {"split": "validation"}, r"not for this toy6 \(validation split\)"),
        ("none", SCENARIO, {"seeds": range(1000, 1002)}, "not for seed 1000"),
        ("none", SCENARIO, {"seeds": [0]}, "an interval takes at least 2 episodes"),
        ("no-such-policy", SCENARIO, {}, "no controller 'no-such-policy'"),
        ("none", "no-such-scenario", {}, "no-such-scenario"),
        (np.sin, SCENARIO, {}, r"policy is of type ufunc; .*, or RowPolicy\(function\) for a function of rows"),
        (Policy, SCENARIO, {}, "policy is of type type"),
        (PPO, SCENARIO, {}, "policy is of type ABCMeta"),
        ("none", SCENARIO, {"seeds": 4}, r"seeds is 4; give a sequence of seeds, such as range\(32\)"),
        ("none", SCENARIO, {"seeds": []}, "seeds has the length 0; an interval takes at least 2"),
        ("none", SCENARIO, {"seeds": [0, 1, 1]}, "seeds has a seed twice"),
    ],
)
def test_what_cannot_be_scored_is_refused_with_a_reason(policy, scenario, options, said):
    with pytest.raises((ValueError, TypeError), match=said):
        dcgrid_env.score(policy, scenario, **options)


def test_recurrent_models_are_refused(model):
    model.policy.lstm_actor = None
    with pytest.raises(ValueError, match="model: it is recurrent; write a controller class"):
        dcgrid_env.score(model, SCENARIO)
