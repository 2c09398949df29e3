"""The native batch: gymnasium's vector conventions, and the same episodes as the single environment."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector
from stable_baselines3.common.vec_env import SubprocVecEnv

import dcgrid_env
from dcgrid_env import DcgridEnv, DcgridVectorEnv
from dcgrid_env.envs.vector import _warn_about_statistics
from dcgrid_env.traces import PowerTrace
from helpers.forms import WORK_CLASSES, each_preset
from helpers.in_other_processes import toy

OLD = tuple(map(int, gymnasium.__version__.split(".")[:2])) < (1, 4)
CLASSES = WORK_CLASSES | {"workload.site_correlation": 0.5}


@pytest.mark.parametrize("extra", [{}, CLASSES], ids=["linear", "work_classes"])
@pytest.mark.parametrize("scenario", each_preset())
def test_a_batch_has_the_bits_of_single_environments(scenario, extra):
    n_env, horizon = 70, 6  # more environments than two threads' share, and three episodes each
    batch = DcgridVectorEnv(n_env, scenario, horizon=horizon, **extra)
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
            assert {k for k in infos if f"_{k}" in infos and infos[f"_{k}"][i]} >= info.keys()


def collapsing():
    """Episodes that end at 12 steps, or before in a voltage collapse, each environment's at its own time."""
    times = np.arange(3000.0)
    jumps = np.random.default_rng(0).random(3000) < 0.08
    trace = PowerTrace(times, np.where(jumps, 1.0, 0.2), name="jumps")
    return {
        "datacenters.p_rated_kw": 9000.0,
        "n_datacenters": 1,
        "datacenters.buses": (18,),
        "horizon": 12,
        "trace": (trace,),
    }


def assert_alike(mine, theirs):
    """Compare infos; gymnasium leaves out what no environment has, and a batch has it with a mask that is False."""
    assert mine.keys() >= theirs.keys()
    assert not any(mine[f"_{key.removeprefix('_')}"].any() for key in mine.keys() - theirs.keys())
    for key, other in theirs.items():
        if isinstance(other, dict):
            assert_alike(mine[key], other)
        elif other.dtype == object:
            assert [o is None for o in mine[key]] == [o is None for o in other]
            for a, b in zip(mine[key], other, strict=True):
                np.testing.assert_array_equal(a, b)
        else:
            assert mine[key].dtype == other.dtype, key
            valid = theirs.get(f"_{key}", np.ones(len(other), bool))  # the rest is whatever comes to hand
            np.testing.assert_array_equal(mine[key][valid], other[valid], err_msg=key)


def assert_same_steps(ours, theirs, steps, *, mask_resets=()):
    """Compare both step by step, with random resets before some steps; return where episodes of ours ended."""
    ours.action_space.seed(0)
    rng, ended = np.random.default_rng(1), []
    mode = theirs.autoreset_mode
    a, b = ours.reset(seed=5), theirs.reset(seed=5)
    done = np.zeros(ours.num_envs, bool)
    for t in range(steps):
        mask = done.copy() if mode is AutoresetMode.DISABLED else np.zeros(ours.num_envs, bool)
        if t in mask_resets:
            mask |= rng.random(ours.num_envs) < 0.4
        if mask.any():
            a, b = (env.reset(options={"reset_mask": mask.copy()}) for env in (ours, theirs))
            np.testing.assert_array_equal(a[0], b[0])
            assert_alike(a[1], b[1])
        actions = np.abs(ours.action_space.sample())
        a, b = ours.step(actions), theirs.step(actions)
        for mine, other in zip(a[:4], b[:4], strict=True):
            np.testing.assert_array_equal(mine, other)
            assert mine.dtype == other.dtype
        assert_alike(a[4], b[4])
        done = a[2] | a[3]
        ended += [(t, env_index) for env_index in np.flatnonzero(done)]
    return ended


@pytest.mark.parametrize("info", ["full", "costs", "none"])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_every_mode_is_gymnasiums_own(mode, info):
    extra = collapsing() | {"info": info}
    ours = gymnasium.make_vec("dcgrid/IEEE33Weak-v0", num_envs=5, autoreset_mode=mode.name.lower(), **extra)
    theirs = SyncVectorEnv([lambda: DcgridEnv("ieee33-weak", **extra)] * 5, autoreset_mode=mode)
    assert isinstance(ours.unwrapped, DcgridVectorEnv)
    assert ours.unwrapped.autoreset_mode is ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    ended = assert_same_steps(ours, theirs, 60, mask_resets=(7, 20, 33))
    assert len({t for t, _ in ended}) > 8  # at times of their own
    assert {env_index for _, env_index in ended} == set(range(5))
    together = [t for t in range(60) if [s for s, _ in ended].count(t) > 1]
    assert len(together) > 0


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_environments_that_all_end_at_once(mode):
    ours = DcgridVectorEnv(3, "ieee123", autoreset_mode=mode, horizon=2)
    theirs = SyncVectorEnv([lambda: DcgridEnv("ieee123", horizon=2)] * 3, autoreset_mode=mode)
    assert len(assert_same_steps(ours, theirs, 9)) in (3 * 3, 4 * 3)


def test_the_mode_is_each_batchs_own():
    one, two = DcgridVectorEnv(1, "toy6"), DcgridVectorEnv(1, "toy6", autoreset_mode=AutoresetMode.NEXT_STEP)
    assert one.metadata["autoreset_mode"] is one.autoreset_mode is AutoresetMode.SAME_STEP
    assert two.metadata["autoreset_mode"] is two.autoreset_mode is AutoresetMode.NEXT_STEP
    for mode in ("later", None):
        with pytest.raises(ValueError, match="choose one of next_step, same_step, disabled"):
            DcgridVectorEnv(1, "toy6", autoreset_mode=mode)  # pyright: ignore[reportArgumentType]


def test_a_step_of_environments_that_are_over_is_refused_where_none_begins_by_itself():
    env = DcgridVectorEnv(3, "toy6", autoreset_mode="disabled", horizon=2)
    env.reset(seed=0)
    env.step(np.zeros((3, 4)))
    env.reset(options={"reset_mask": np.array([False, True, False])})
    *_, truncated, _ = env.step(np.zeros((3, 4)))
    assert truncated.tolist() == [True, False, True]
    before = env.save()
    with pytest.raises(RuntimeError, match=r"environments \[0, 2\] are over; reset them with options={'reset_mask'"):
        env.step(np.zeros((3, 4)))
    assert env.save() is before
    # So is that of a batch that begins anew in the same step, given a snapshot of one that does not.
    other = DcgridVectorEnv(3, "toy6", horizon=2)
    other.restore(before)
    with pytest.raises(RuntimeError, match=r"environments \[0, 2\] are over"):
        other.step(np.zeros((3, 4)))


def test_save_and_restore_between_an_end_and_the_next_beginning():
    extra = collapsing()
    env = DcgridVectorEnv(5, "ieee33-weak", autoreset_mode="next_step", **extra)
    env.reset(seed=5)
    actions = np.ones((40, 5, 6))
    at = next(t for t in range(40) if (lambda step: (step[2] | step[3]).any())(env.step(actions[t])))
    saved = env.save()
    course = [env.step(action)[:4] for action in actions[at:]]
    again = DcgridVectorEnv(5, "ieee33-weak", autoreset_mode="next_step", **extra)
    again.restore(saved)
    for action, wanted in zip(actions[at:], course, strict=True):
        for found, expected in zip(again.step(action), wanted, strict=False):
            np.testing.assert_array_equal(found, expected)


def test_an_environment_that_waits_for_its_next_episode_does_not_run_out_of_load():
    # The recording's training share is one window to the second: there is no load beyond an episode's end.
    load = PowerTrace(np.arange(41.0), np.linspace(0.2, 0.9, 41), name="short")
    extra = {"trace": (load,), "horizon": 22}
    env = DcgridVectorEnv(2, "toy6", autoreset_mode="next_step", **extra)
    env.reset(seed=0)
    still = np.zeros((2, 4))
    env.step(still)
    env.reset(options={"reset_mask": np.array([True, False])})  # so that environment 1 ends a step before environment 0
    ends = [tuple(env.step(still)[3]) for _ in range(23)]
    assert ends[-3:] == [(False, True), (True, False), (False, False)]


def test_buses_in_info_are_those_of_the_episode_that_begins():
    env = DcgridVectorEnv(2, "ieee123", autoreset_mode="next_step", horizon=1)
    env.reset(seed=0)
    single = DcgridEnv("ieee123", horizon=1)
    single.reset(seed=0)
    env.step(np.zeros((2, 17)))
    *_, infos = env.step(np.zeros((2, 17)))
    wanted = single.reset()[1]
    assert {name: infos[name][0] for name in wanted} == wanted


@pytest.mark.parametrize("mode", ["next_step", "disabled"])
def test_gymnasiums_vector_observation_wrappers_take_it(mode):
    def made():
        return gymnasium.make_vec("dcgrid/IEEE33Weak-v0", num_envs=4, horizon=5, autoreset_mode=mode)

    plain, flat = made(), vector.FlattenObservation(made())
    halved = vector.VectorizeTransformObservation(
        made(), wrappers.TransformObservation, func=lambda observation: 0.5 * observation, observation_space=None
    )
    for t in range(12):
        if t == 0 or (mode == "disabled" and t in (5, 10)):
            seen, of_flat, of_halved = (env.reset(seed=0)[0] for env in (plain, flat, halved))
        else:
            action = np.full((4, 10), 0.5, np.float32)
            seen, of_flat, of_halved = (env.step(action)[0] for env in (plain, flat, halved))
        np.testing.assert_array_equal(of_flat, seen)
        np.testing.assert_array_equal(of_halved, 0.5 * seen)


def ends_of_episodes(env, steps):
    """Each step's rewards, ends and infos of a batch with random actions, and which rows it began."""
    env.reset(seed=4)
    env.action_space.seed(0)
    done = np.zeros(env.num_envs, bool)
    for _ in range(steps):
        waits = done
        if env.unwrapped.autoreset_mode is AutoresetMode.DISABLED and done.any():
            _, infos = env.reset(options={"reset_mask": done.copy()})
            assert not any(key in infos for key in OF_STEPS)
            assert infos["_voltage_min_pu"].tolist() == done.tolist()
        _, rewards, terminated, truncated, infos = env.step(env.action_space.sample())
        done = terminated | truncated
        begun = {"SAME_STEP": done, "NEXT_STEP": waits, "DISABLED": np.zeros_like(done)}
        yield rewards, done, infos, begun[env.unwrapped.autoreset_mode.name]


OF_STEPS = ("J", "cost", "cost_voltage", "cost_trips", "reward_vector", "ups_trips", "ups_lost_kw")


@pytest.mark.parametrize("mode", ["same_step", "next_step", "disabled"])
@pytest.mark.parametrize("reward", ["shared", "difference"])
def test_what_a_step_is_charged_is_in_the_infos_of_its_episode(mode, reward):
    extra = {"horizon": 5, "reward": reward, "autoreset_mode": mode}
    if reward == "shared":
        extra |= {"datacenters.ride_through": {"curve": "itic", "trip_weight": 50.0}}
    env = DcgridVectorEnv(3, "ieee33-weak", **extra)
    returns, ended = np.zeros(3), 0
    for rewards, done, infos, begun in ends_of_episodes(env, 13):
        returns = np.where(begun & ~done, 0.0, returns + rewards)
        present = [key for key in OF_STEPS if key in infos]
        assert len(present) == (4 if reward == "difference" else 6)
        for key in present:
            np.testing.assert_array_equal(infos[f"_{key}"], ~begun)
            assert np.isnan(infos[key][begun]).all()
            assert np.isfinite(infos[key][~begun]).all()
        assert infos["_voltage_min_pu"].all()
        assert np.isfinite(infos["voltage_min_pu"]).all()
        if done.any():
            last = infos["final_info"] if mode == "same_step" else infos
            assert last["_J"].tolist() == last["_cost"].tolist() == done.tolist() or mode != "same_step"
            terms = np.sum([values for key, values in last.items() if key.startswith("cost_")], axis=0)
            if reward == "difference":
                np.testing.assert_allclose(last["reward_vector"].sum(-1)[done], rewards[done], rtol=1e-12)
            else:
                np.testing.assert_allclose(terms[done], -rewards[done], rtol=1e-12)
                np.testing.assert_allclose(5.0 * last["J"][done], -returns[done], rtol=1e-12)
            ended += 1
            returns[done] = 0.0
    assert ended == 2


def test_a_partial_reset_leaves_the_step_figures_of_the_others():
    env = DcgridVectorEnv(3, "toy6", autoreset_mode="next_step", horizon=3)
    env.reset(seed=0)
    env.step(np.zeros((3, 4)))
    env.reset(options={"reset_mask": np.array([True, False, False])})
    seen = [env.step(np.zeros((3, 4)))[-1]["_J"].tolist() for _ in range(4)]
    assert seen == [[True] * 3, [True] * 3, [True, False, False], [False, True, True]]


@pytest.mark.parametrize("mode", ["same_step", "next_step"])
def test_environments_on_random_feeders_begin_without_step_figures(mode):
    env = DcgridVectorEnv(2, "zero-shot", autoreset_mode=mode, horizon=2)
    _, infos = env.reset(seed=0)
    assert "J" not in infos
    masks = [env.step(env.action_space.sample())[-1]["_J"].tolist() for _ in range(3)]
    assert masks == ([[True] * 2, [False] * 2, [True] * 2] if mode == "same_step" else [[True] * 2] * 2 + [[False] * 2])


def test_the_statistics_of_old_releases_of_gymnasium_are_warned_of_once(monkeypatch):
    def made(**extra):
        return gymnasium.make_vec("dcgrid/Toy6-v0", num_envs=2, **extra)

    _warn_about_statistics.cache_clear()
    monkeypatch.setattr(gymnasium, "__version__", "1.3.0")
    made(autoreset_mode="next_step")
    with pytest.warns(UserWarning, match=r"in gymnasium 1\.3\.0.*install gymnasium 1\.4 or newer, or .*'next_step'"):
        made()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made()
        for version in ("1.4.0", "1.10.2", "2.0.0a1"):
            monkeypatch.setattr(gymnasium, "__version__", version)
            made()


@pytest.mark.skipif(OLD, reason="wrong in this gymnasium, of which make_vec warns")
def test_gymnasium_s_statistics_of_episodes_that_begin_in_the_same_step():
    env = vector.RecordEpisodeStatistics(gymnasium.make_vec("dcgrid/IEEE33Weak-v0", num_envs=2, horizon=5))
    env.reset(seed=0)
    ends = [infos for infos in (env.step(np.zeros((2, 10), np.float32))[-1] for _ in range(15)) if "episode" in infos]
    assert [infos["episode"]["l"].tolist() for infos in ends] == [[5, 5]] * 3
    for infos in ends:
        np.testing.assert_allclose(infos["episode"]["r"], -5.0 * infos["final_info"]["J"], rtol=1e-12)


def test_gymnasium_normalises_observations():
    made = {"num_envs": 4, "horizon": 5, "autoreset_mode": "next_step"}
    plain = gymnasium.make_vec("dcgrid/IEEE33Weak-v0", **made)
    normalised = vector.NormalizeObservation(gymnasium.make_vec("dcgrid/IEEE33Weak-v0", **made))
    all_seen = [plain.reset(seed=0)[0]]
    normalised.reset(seed=0)
    for _ in range(12):
        action = np.full((4, 10), 0.5, np.float32)
        all_seen.append(plain.step(action)[0])
        assert np.isfinite(normalised.step(action)[0]).all()
    np.testing.assert_allclose(normalised.obs_rms.mean, np.concatenate(all_seen).mean(axis=0), atol=1e-4)


def test_gymnasiums_statistics_and_rewards_of_whole_episodes():
    made = {"num_envs": 4, "horizon": 5, "autoreset_mode": "next_step"}
    env = vector.RecordEpisodeStatistics(gymnasium.make_vec("dcgrid/IEEE33Weak-v0", **made))
    scaled = vector.NormalizeReward(gymnasium.make_vec("dcgrid/IEEE33Weak-v0", **made))
    env.reset(seed=0)
    scaled.reset(seed=0)
    ends = 0
    for _ in range(18):
        action = np.full((4, 10), 0.5, np.float32)
        *_, truncated, infos = env.step(action)
        assert np.isfinite(scaled.step(action)[1]).all()
        if truncated.any():
            ends += 1
            assert infos["episode"]["l"].tolist() == [5] * 4
            np.testing.assert_allclose(infos["episode"]["r"], -5.0 * infos["J"], rtol=1e-6)
    assert ends == 3


@pytest.mark.parametrize("extra", [{}, CLASSES], ids=["linear", "work_classes"])
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
    np.testing.assert_array_equal(infos["_loss_kw"], mask)
    assert "cost" not in infos
    after, *_ = env.step(np.zeros((4, 17)))
    alone = DcgridEnv("ieee123", **extra)
    alone.reset(seed=10)
    np.testing.assert_array_equal(after[3], alone.step(np.zeros(17))[0])


def test_a_collapsed_environment_begins_anew_and_leaves_the_others_alone():
    calm = PowerTrace(np.arange(500.0), np.r_[1.0, np.full(499, 0.2)], name="calm")
    peak = PowerTrace(np.arange(500.0), np.where(np.arange(500) % 50 < 25, 0.2, 1.0), name="peak")
    heavy = {
        "datacenters.p_rated_kw": 9000.0,
        "n_datacenters": 1,
        "datacenters.buses": (18,),
        "horizon": 60,
        "trace": (calm, peak),
    }
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
    with pytest.raises(dcgrid_env.ActionError, match="action of inv_1: q is nan in environment 1"):
        env.step(bad)


@pytest.mark.parametrize("kind", ["fork", "spawn"])
@pytest.mark.slow
def test_async_vector_env(kind):
    if kind == "fork":
        DcgridVectorEnv(256, "ieee123").reset(seed=0)  # threads of this process must not matter to a forked child
    env = AsyncVectorEnv([toy] * 2, context=kind, autoreset_mode=AutoresetMode.SAME_STEP)
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


@pytest.mark.slow
def test_subproc_vec_env():
    env = SubprocVecEnv([toy, toy], start_method="spawn")
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
    assert env.transition.truncated.all()  # the step's, though the environments have begun anew
    np.testing.assert_array_equal(env.transition.reward, rewards)
    seen, _ = env.reset(seed=7)
    np.testing.assert_array_equal(env.transition.observation, seen)


def test_first_resets_that_cannot_be():
    env = DcgridVectorEnv(2, "toy6")
    with pytest.raises(ValueError, match="the first reset must be of all environments"):
        env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(ValueError, match=r"seed is 1\.5"):
        env.reset(seed=[1.5, 2])  # pyright: ignore[reportArgumentType]
    env.reset(seed=[None, 4])
    np.testing.assert_array_equal(env.transition.observation[1], DcgridEnv("toy6").reset(seed=4)[0])


def test_environments_made_alike_share_what_is_derived():
    one, two = DcgridEnv("ieee123", horizon=7), DcgridEnv("ieee123", horizon=7)
    assert one.scenario is two.scenario


@pytest.mark.parametrize("scenario", ["toy6", "ieee13-3ph", "ride-through"])
def test_a_fork_goes_on_from_the_environments_that_it_copies_bit_for_bit(scenario):
    batch = DcgridVectorEnv(3, scenario, horizon=6)
    batch.reset(seed=5)
    batch.action_space.seed(0)
    actions = [batch.action_space.sample() for _ in range(6)]
    for action in actions[:3]:
        batch.step(action)
    copied = [2, 0, 2, 2]
    fork, seen = batch.fork(copied), []
    for action in actions[3:]:
        _, rewards, *_ = batch.step(action)
        seen, rewards_of_fork, *_ = fork.step(action[copied])
        np.testing.assert_array_equal(rewards_of_fork, rewards[copied])
        np.testing.assert_array_equal(fork.transition.state.v_pu, batch.transition.state.v_pu[copied])
        np.testing.assert_array_equal(fork.transition.j_so_far, batch.transition.j_so_far[copied])
    assert len(seen) == 4


def test_what_cannot_be_forked():
    batch = DcgridVectorEnv(2, "toy6")
    with pytest.raises(RuntimeError, match="has not been reset"):
        batch.fork([0])
    batch.reset(seed=0)
    for n_env in ([], [2], [-1], np.array([0.5]), np.array([[0]])):
        with pytest.raises(ValueError, match=r"env_indices is .*; give positions in 0 .. 1, at least one"):
            batch.fork(n_env)
    zero_shot = DcgridVectorEnv(2, "zero-shot", horizon=2)
    zero_shot.reset(seed=0)
    with pytest.raises(dcgrid_env.ScenarioError, match="random feeders cannot be copied"):
        zero_shot.fork([0])
