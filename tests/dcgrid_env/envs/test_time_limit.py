"""Limits of Gymnasium and PettingZoo are the horizon or are refused by name, and leftover work is charged."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import RecordEpisodeStatistics, TimeLimit

from dcgrid_env import DcgridEnv, DcgridVectorEnv, Scenario, ScenarioError, make_scenario, parallel_env

ID = "dcgrid/IEEE33Weak-v0"


def scenario_of(env: Any) -> Scenario:
    return env.unwrapped.scenario


@pytest.mark.parametrize("checked", [True, False])
def test_max_episode_steps_below_the_horizon_is_refused_by_name(checked):
    env = gymnasium.make(ID, max_episode_steps=30, disable_env_checker=not checked)
    with pytest.raises(ScenarioError, match=r"TimeLimit of 30 steps .* horizon of 120, .* horizon=30"):
        env.reset(seed=0)


@pytest.mark.parametrize("steps", [30, 50])
def test_leftover_work_is_charged_at_the_horizon_within_any_limit(steps):
    env: Any = gymnasium.make(ID, max_episode_steps=steps, horizon=30)
    env.reset(seed=1)
    action = np.zeros(env.action_space.shape, np.float32)
    action[: 2 * scenario_of(env).datacenters.count : 2] = -1.0
    ends = [env.step(action)[3:] for _ in range(30)]
    assert [over for over, _ in ends] == [False] * 29 + [True]
    info = ends[-1][-1]
    assert info["cost_leftover"] == pytest.approx(9.0 * info["backlog_kws"] / 3000.0)
    assert info["cost_leftover"] > 1.0


def test_the_spec_of_a_batch_carries_it():
    batch: Any = gymnasium.make_vec(ID, num_envs=2, max_episode_steps=30)
    assert scenario_of(batch).horizon == 30
    assert isinstance(batch.unwrapped, DcgridVectorEnv)
    assert scenario_of(gymnasium.make_vec(batch.spec)) is scenario_of(batch)


def test_no_limit_leaves_the_horizon():
    assert scenario_of(gymnasium.make(ID, max_episode_steps=-1)).horizon == 120
    assert DcgridVectorEnv(2, "toy6", max_episode_steps=-1).scenario.horizon == 100


def test_batches_take_it():
    batch = gymnasium.make_vec(ID, num_envs=2, max_episode_steps=5)
    wanted = gymnasium.make_vec(ID, num_envs=2, horizon=5)
    assert batch.single_observation_space == wanted.single_observation_space
    batch.reset(seed=0)
    ends = [batch.step(np.zeros((2, 10), np.float32))[3].tolist() for _ in range(5)]
    assert ends == [[False] * 2] * 4 + [[True] * 2]


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda **steps: gymnasium.make_vec(ID, **steps), "max_episode_steps"),
        (lambda **steps: parallel_env("toy6", **steps), "max_cycles"),
    ],
    ids=["make_vec", "parallel_env"],
)
def test_two_lengths_of_an_episode_are_refused(make, name):
    with pytest.raises(ScenarioError, match=f"{name} is 30 and horizon is 40, .* give one"):
        make(**{name: 30, "horizon": 40})
    for steps in (0, -2, 2.5, True):
        with pytest.raises(ScenarioError, match=f"{name} is {steps!r}; give a whole number"):
            make(**{name: steps})


def test_a_shorter_limit_put_around_it_by_hand_is_refused():
    env = RecordEpisodeStatistics(TimeLimit(gymnasium.make(ID), 30))
    with pytest.raises(ScenarioError, match=r"TimeLimit of 30 steps .* horizon of 120, .* horizon=30"):
        env.reset(seed=0)
    with pytest.raises(ScenarioError, match="TimeLimit of 30 steps"):
        TimeLimit(gymnasium.make(ID, max_episode_steps=60, horizon=60), 30).reset(seed=0)
    TimeLimit(gymnasium.make(ID), 120).reset(seed=0)
    TimeLimit(gymnasium.make(ID), 500).reset(seed=0)


def test_limits_of_other_environments_do_not_matter():
    class Outer(gymnasium.Env):
        """Each of its steps is a whole episode of ours."""

        observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (10,), np.float32)

        def __init__(self, **kwargs):
            self.inner = DcgridEnv(make_scenario("ieee33-weak"))

        def reset(self, *, seed=None, options=None):
            return self.inner.reset(seed=seed)

    spec = EnvSpec("Outer-v0", entry_point=Outer, disable_env_checker=True)
    env: Any = gymnasium.make(spec, max_episode_steps=3)
    env.reset(seed=0)
    assert env.unwrapped.inner.scenario.horizon == 120
