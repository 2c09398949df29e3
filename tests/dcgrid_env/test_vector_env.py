"""The native batch: gymnasium's vector conventions, and the same episodes as the single environment."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from stable_baselines3.common.vec_env import SubprocVecEnv

import dcgrid_env
from dcgrid_env import DcgridEnv, DcgridVectorEnv, PhaseDvfs
from dcgrid_env.traces import PowerTrace

PHASES = {"dvfs": PhaseDvfs(), "boost_share": 1.3, "site_correlation": 0.5, "trace": "mixed"}


@pytest.mark.parametrize("extra", [{}, PHASES], ids=["linear", "phases"])
@pytest.mark.parametrize("scenario", dcgrid_env.PRESETS)
def test_lanes_are_the_single_environments_bit_for_bit(scenario, extra):
    lanes, horizon = 70, 6  # more lanes than two threads' share, and three episodes each
    batch = DcgridVectorEnv(lanes, scenario, horizon=horizon, **extra)
    singles = {i: DcgridEnv(scenario, horizon=horizon, **extra) for i in (0, 1, 33, 69)}
    seen, _ = batch.reset(seed=100)
    for i, single in singles.items():
        np.testing.assert_array_equal(single.reset(seed=100 + i)[0], seen[i])
    batch.action_space.seed(1)
    for t in range(3 * horizon):
        actions = batch.action_space.sample()
        seen, rewards, terminated, truncated, infos = batch.step(actions)
        for i, single in singles.items():
            observation, reward, *ends, info = single.step(actions[i])
            assert reward == rewards[i]
            assert ends == [terminated[i], truncated[i]]
            np.testing.assert_array_equal(single.transition.state.v_pu[0], batch.transition.state.v_pu[i])
            if any(ends):
                assert t % horizon == horizon - 1
                np.testing.assert_array_equal(infos["final_obs"][i], observation)
                assert {k: infos["final_info"][k][i] for k in info} == info
                observation, info = single.reset()
            np.testing.assert_array_equal(seen[i], observation)
            assert {k: infos[k][i] for k in info} == info


def test_conventions_agree_with_gymnasiums_own_vector_environment():
    ours = gymnasium.make_vec("dcgrid/Toy6-v0", num_envs=3, horizon=2)
    theirs = SyncVectorEnv([lambda: DcgridEnv("toy6", horizon=2)] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    assert isinstance(ours.unwrapped, DcgridVectorEnv)
    assert ours.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    a, info_a = ours.reset(seed=5)
    b, info_b = theirs.reset(seed=5)
    np.testing.assert_array_equal(a, b)
    assert info_a.keys() == info_b.keys()
    ours.action_space.seed(0)
    for _ in range(5):
        actions = ours.action_space.sample()
        *mine, my_info = ours.step(actions)
        *other, other_info = theirs.step(actions)
        for a, b in zip(mine, other, strict=True):
            np.testing.assert_array_equal(a, b)
            assert np.asarray(a).dtype == np.asarray(b).dtype
        assert my_info.keys() == other_info.keys()
        for key in my_info.keys() - {"final_info", "final_obs"}:
            np.testing.assert_array_equal(my_info[key], other_info[key])
        if "final_obs" in my_info:
            np.testing.assert_array_equal(np.stack(my_info["final_obs"]), np.stack(other_info["final_obs"]))
            assert my_info["final_info"].keys() == other_info["final_info"].keys()


@pytest.mark.parametrize("extra", [{}, PHASES], ids=["linear", "phases"])
def test_reset_mask_and_seed_lists(extra):
    env = DcgridVectorEnv(4, "ieee123", **extra)
    first, _ = env.reset(seed=[7, 8, 9, 10])
    np.testing.assert_array_equal(first, DcgridVectorEnv(4, "ieee123", **extra).reset(seed=7)[0])
    env.step(env.action_space.sample())
    before = env.transition.observation.copy()
    mask = np.array([True, False, False, True])
    after, infos = env.reset(seed=[7, None, None, 10], options={"reset_mask": mask})
    np.testing.assert_array_equal(after[mask], first[mask])
    np.testing.assert_array_equal(after[~mask], before[~mask])
    np.testing.assert_array_equal(infos["_cost"], mask)
    after, *_ = env.step(np.zeros((4, 17)))
    alone = DcgridEnv("ieee123", **extra)
    alone.reset(seed=10)
    np.testing.assert_array_equal(after[3], alone.step(np.zeros(17))[0])


def test_a_collapsed_lane_begins_anew_and_leaves_the_others_alone():
    calm = PowerTrace(np.arange(500.0), np.r_[1.0, np.full(499, 0.2)], name="calm")
    peak = PowerTrace(np.arange(500.0), np.where(np.arange(500) % 50 < 25, 0.2, 1.0), name="peak")
    heavy = {"p_rated_kw": 9000.0, "n_datacenters": 1, "datacenter_buses": (18,), "horizon": 60, "trace": (calm, peak)}
    env = DcgridVectorEnv(8, "ieee33-weak", **heavy)
    env.reset(seed=0)
    alone = {i: DcgridEnv("ieee33-weak", **heavy) for i in range(8)}
    for i, single in alone.items():
        single.reset(seed=i)
    collapsed = np.zeros(8, dtype=int)
    for _ in range(60):
        seen, rewards, terminated, truncated, infos = env.step(np.ones((8, 6)))
        collapsed += terminated
        for i, single in alone.items():
            observation, reward, *_ = single.step(np.ones(6))
            assert reward == rewards[i]
            if terminated[i] or truncated[i]:
                np.testing.assert_array_equal(infos["final_obs"][i], observation)
                observation, _ = single.reset()
            np.testing.assert_array_equal(observation, seen[i])
    assert 0 < np.count_nonzero(collapsed) < 8


def test_errors_of_use():
    with pytest.raises(ValueError, match="num_envs is 0"):
        DcgridVectorEnv(0, "toy6")
    env = DcgridVectorEnv(2, "toy6")
    with pytest.raises(ValueError, match="3 seeds for num_envs = 2"):
        env.reset(seed=[1, 2, 3])
    env.reset(seed=0)
    with pytest.raises(ValueError, match="reset_mask must be a bool array"):
        env.reset(options={"reset_mask": np.array([1, 0])})
    bad = np.zeros((2, 4))
    bad[1, 3] = np.nan
    with pytest.raises(dcgrid_env.ActionError, match="action of inv_1: q is nan in lane 1"):
        env.step(bad)


def _make():
    return gymnasium.make("dcgrid_env:dcgrid/Toy6-v0", horizon=3)


@pytest.mark.parametrize("kind", ["fork", "spawn"])
def test_async_vector_env(kind):
    if kind == "fork":
        DcgridVectorEnv(256, "ieee123").reset(seed=0)  # threads of this process must not matter to a forked child
    env = AsyncVectorEnv([_make] * 2, context=kind, autoreset_mode=AutoresetMode.SAME_STEP)
    try:
        seen, _ = env.reset(seed=3)
        native = DcgridVectorEnv(2, "toy6", horizon=3)
        np.testing.assert_array_equal(seen, native.reset(seed=3)[0])
        env.action_space.seed(0)
        for _ in range(4):
            actions = env.action_space.sample()
            np.testing.assert_array_equal(env.step(actions)[0], native.step(actions)[0])
    finally:
        env.close()


def test_subproc_vec_env():
    env = SubprocVecEnv([_make, _make], start_method="spawn")
    try:
        env.seed(3)
        seen = env.reset()
        np.testing.assert_array_equal(seen, DcgridVectorEnv(2, "toy6").reset(seed=3)[0])
    finally:
        env.close()


def test_the_transition_is_the_last_steps_or_resets():
    env = DcgridVectorEnv(2, "toy6", horizon=2)
    env.reset(seed=1)
    env.step(np.zeros((2, 4)))
    _, rewards, *_ = env.step(np.zeros((2, 4)))
    assert env.transition.truncated.all()  # the step's, though the lanes have begun anew
    np.testing.assert_array_equal(env.transition.reward, rewards)
    seen, _ = env.reset(seed=7)
    np.testing.assert_array_equal(env.transition.observation, seen)


def test_first_resets_that_cannot_be():
    env = DcgridVectorEnv(2, "toy6")
    with pytest.raises(ValueError, match="the first reset must be of all lanes"):
        env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match=r"seed is 1\.5"):
        env.reset(seed=[1.5, 2])  # pyright: ignore[reportArgumentType]
    env.reset(seed=[None, 4])
    np.testing.assert_array_equal(env.transition.observation[1], DcgridEnv("toy6").reset(seed=4)[0])


def test_environments_made_alike_share_what_is_derived():
    one, two = DcgridEnv("ieee123", horizon=7), DcgridEnv("ieee123", horizon=7)
    assert one.scenario is two.scenario
