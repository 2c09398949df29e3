"""Limits of Gymnasium and PettingZoo are the horizon, and leftover work is charged."""

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import ClipAction, TimeAwareObservation, TimeLimit

from dcgrid_env import (
    IDS,
    DcgridEnv,
    DcgridVectorEnv,
    EpisodeCutWarning,
    Scenario,
    ScenarioError,
    make_scenario,
    parallel_env,
)
from dcgrid_env.traces import PowerTrace

ID = "dcgrid/IEEE33Weak-v0"


def scenario_of(env: Any) -> Scenario:
    return env.unwrapped.scenario


def rewards(env: Any) -> list[float]:
    """Rewards of an episode in which all work waits, which ends in its last step by truncation alone."""
    env.reset(seed=1)
    action = np.zeros(env.action_space.shape, np.float32)
    action[: 2 * scenario_of(env).datacenters.count : 2] = -1.0
    paid, terminated, truncated, info = [], False, False, {}
    while not (terminated or truncated):
        _, reward, terminated, truncated, info = env.step(action)
        paid.append(reward)
    assert (terminated, truncated) == (False, True)
    assert info["cost_leftover"] == pytest.approx(9.0 * info["backlog_kws"] / 3000.0)
    assert info["cost_leftover"] > 1.0
    return paid


def make(*args: Any, **kwargs: Any) -> Any:
    return gymnasium.make(*args, **kwargs)


def make_vec(*args: Any, **kwargs: Any) -> Any:
    return gymnasium.make_vec(*args, **kwargs)


WAYS = {
    "make": lambda **steps: make(ID, **steps),
    "make with Gymnasium's checker": lambda **steps: make(ID, disable_env_checker=False, **steps),
    "its spec": lambda **steps: make(make(ID).spec, **steps),
    "its spec as JSON": lambda **steps: make(EnvSpec.from_json(make(ID).spec.to_json()), **steps),
    "its spec in a pickle": lambda **steps: make(pickle.loads(pickle.dumps(make(ID).spec)), **steps),
    "a copy of the registered spec": lambda **steps: make(copy.deepcopy(gymnasium.spec(ID)), **steps),
    "the spec of a wrapper": lambda **steps: make(ClipAction(make(ID)).spec, **steps),
    "a batch of single environments": lambda **steps: make_vec(ID, vectorization_mode="sync", **steps).envs[0],
    "a scenario": lambda **steps: make(ID, scenario=make_scenario("ieee33-weak", split="train"), **steps),
}
"""Ways to make a single environment."""


@pytest.mark.parametrize("steps", [15, 130])
@pytest.mark.parametrize("way", WAYS)
def test_max_episode_steps_is_the_horizon(way, steps):
    env = WAYS[way](max_episode_steps=steps)
    assert scenario_of(env).horizon == env.spec.max_episode_steps == steps
    assert env.observation_space == DcgridEnv("ieee33-weak", horizon=steps).observation_space
    assert rewards(env) == rewards(DcgridEnv("ieee33-weak", horizon=steps))


@pytest.mark.parametrize("steps", [15, 130])
@pytest.mark.parametrize("way", WAYS)
def test_a_horizon_is_not_cut_by_the_preset_s(way, steps):
    env = WAYS[way](horizon=steps)
    assert scenario_of(env).horizon == env.spec.max_episode_steps == steps
    assert len(rewards(env)) == steps


def test_the_preset_s_spec_has_its_horizon():
    steps = {gym_id: gymnasium.spec(gym_id).max_episode_steps for gym_id in ("dcgrid/Toy6-v0", ID, "dcgrid/Routing-v0")}
    assert steps == {gym_id: make_scenario(IDS[gym_id]).horizon for gym_id in steps}
    assert steps[ID] == 120
    assert make(ID).spec.max_episode_steps == 120


@pytest.mark.parametrize("given", [{"horizon": 12}, {"max_episode_steps": 12}])
def test_specs_survive_json_with_their_horizon(given):
    for made in (make(ID, **given), make_vec(ID, num_envs=2, **given)):
        again = EnvSpec.from_json(made.spec.to_json())
        assert again == made.spec
        assert again.max_episode_steps == 12


def test_gymnasium_s_observation_of_time_counts_to_the_horizon():
    env: Any = TimeAwareObservation(make(ID, horizon=4), flatten=False, normalize_time=True)
    env.reset(seed=0)
    seen = [env.step(env.action_space.sample()) for _ in range(4)]
    assert [float(observation["time"][0]) for observation, *_ in seen] == [0.25, 0.5, 0.75, 1.0]
    assert [truncated for *_, truncated, _ in seen] == [False] * 3 + [True]
    assert TimeAwareObservation(make(ID)).max_timesteps == 120


def test_two_lengths_of_an_episode_are_refused_in_make():
    for steps in (30, 50):
        with pytest.raises(ScenarioError, match=f"max_episode_steps is {steps} and horizon is 40, .* give one,"):
            make(ID, max_episode_steps=steps, horizon=40)
    assert scenario_of(make(ID, max_episode_steps=40, horizon=40)).horizon == 40


def test_a_voltage_collapse_in_the_last_step_is_not_truncated_too():
    load = PowerTrace(np.array([0.0, 10.0, 400.0]), np.array([0.2, 1.0, 1.0]))  # full from step 10 on
    collapse = {"datacenters.p_rated_kw": 6000.0, "trace": (load,), "workload.window": "start"}
    env: Any = make(ID, max_episode_steps=10, **collapse)
    env.reset(seed=0)
    ends = [env.step(np.ones(10, np.float32))[2:4] for _ in range(10)]
    assert ends == [(False, False)] * 9 + [(True, False)]


def test_a_batch_of_the_spec_of_a_single_environment_is_the_native_one():
    batch: Any = make_vec(make(ID, horizon=7).spec, num_envs=3)
    assert isinstance(batch.unwrapped, DcgridVectorEnv)
    assert (scenario_of(batch).horizon, batch.spec.max_episode_steps) == (7, 7)


def test_the_spec_of_a_batch_carries_it():
    batch: Any = make_vec(ID, num_envs=2, max_episode_steps=30)
    assert scenario_of(batch).horizon == 30
    assert isinstance(batch.unwrapped, DcgridVectorEnv)
    assert batch.spec.max_episode_steps == 30
    assert scenario_of(make_vec(batch.spec)) is scenario_of(batch)
    made: Any = make_vec(make_vec(ID, horizon=20).spec, num_envs=2, horizon=40)
    assert (scenario_of(made).horizon, made.spec.max_episode_steps) == (40, 40)


def test_no_limit_leaves_the_horizon():
    assert scenario_of(make(ID, max_episode_steps=-1)).horizon == 120
    assert DcgridVectorEnv(2, "toy6", max_episode_steps=-1).scenario.horizon == 100


def test_batches_take_it():
    batch = make_vec(ID, num_envs=2, max_episode_steps=5)
    wanted = make_vec(ID, num_envs=2, horizon=5)
    assert batch.single_observation_space == wanted.single_observation_space
    batch.reset(seed=0)
    ends = [batch.step(np.zeros((2, 10), np.float32))[3].tolist() for _ in range(5)]
    assert ends == [[False] * 2] * 4 + [[True] * 2]


@pytest.mark.parametrize(
    ("made", "name"),
    [
        (lambda **steps: make_vec(ID, **steps), "max_episode_steps"),
        (lambda **steps: parallel_env("toy6", **steps), "max_cycles"),
    ],
    ids=["make_vec", "parallel_env"],
)
def test_two_lengths_of_an_episode_are_refused(made, name):
    with pytest.raises(ScenarioError, match=f"{name} is 30 and horizon is 40, .* give one"):
        made(**{name: 30, "horizon": 40})
    for steps in (0, -2, 2.5, True):
        with pytest.raises(ScenarioError, match=f"{name} is {steps!r}; give a whole number"):
            made(**{name: steps})


def test_limits_of_other_environments_do_not_matter():
    class Outer(gymnasium.Env):
        """Each of its steps is a whole episode of ours."""

        observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (10,), np.float32)

        def __init__(self, **kwargs):
            self.inner = DcgridEnv(make_scenario("ieee33-weak"))

        def reset(self, *, seed=None, options=None):
            return self.inner.reset(seed=seed)

    spec = EnvSpec("Outer-v0", entry_point=Outer, disable_env_checker=True)
    env: Any = make(spec, max_episode_steps=3)
    env.reset(seed=0)
    assert env.unwrapped.inner.scenario.horizon == 120


def run_steps(env: Any, lengths: list[int]) -> None:
    """Begin an episode, take some steps, and so on for each of the numbers of steps; then reset once more."""
    for steps in lengths:
        env.reset()
        for _ in range(steps):
            over = any(env.step(np.zeros(env.action_space.shape, np.float32))[2:4])
            if over:
                break
    env.reset()


@pytest.mark.parametrize("steps", [4, 9])
def test_registration_with_another_limit_than_the_horizon_is_refused(steps):
    gymnasium.register(
        "Another-v0", "dcgrid_env:DcgridEnv", max_episode_steps=steps, kwargs={"scenario": "toy6", "horizon": 6}
    )
    try:
        with pytest.raises(ScenarioError, match=rf"max_episode_steps={steps} and its horizon is 6.*'horizon': {steps}"):
            make("Another-v0")
    finally:
        del gymnasium.registry["Another-v0"]


def test_registration_with_the_horizon_as_limit():
    gymnasium.register(
        "Another-v0", "dcgrid_env:DcgridEnv", max_episode_steps=6, kwargs={"scenario": "toy6", "horizon": 6}
    )
    try:
        assert make("Another-v0").spec.max_episode_steps == 6
    finally:
        del gymnasium.registry["Another-v0"]


def test_time_limit_by_hand_warns():
    env = TimeLimit(DcgridEnv("toy6", horizon=6), 4)
    with pytest.warns(EpisodeCutWarning, match=r"reset at step 4, before the end at step 6.*pass horizon=4"):
        run_steps(env, [9, 9, 9])


def test_cycles_by_hand_warn():
    env: Any = parallel_env("toy6", horizon=6)
    env.reset()
    rest = {agent: np.zeros(env.action_space(agent).shape, np.float32) for agent in env.agents}
    for _ in range(2):
        for _ in range(2):
            env.step(rest)
        env.reset()
    env.step(rest)
    env.step(rest)
    with pytest.warns(EpisodeCutWarning, match="pass horizon=2"):
        env.reset()


@pytest.mark.parametrize("lengths", [[4, 4], [4, 3, 4, 4], [4, 4, 6, 4], [1, 1, 1, 1], [0, 0, 0, 0], [6, 6, 6, 6]])
def test_other_resets_do_not_warn(lengths):
    run_steps(DcgridEnv("toy6", horizon=6), lengths)  # a warning is an error in tests
