"""The Gymnasium environment, through the ids a user types."""

import copy
import math
import multiprocessing
import pickle
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_sb3_env

import dcgrid_env
from dcgrid_env import ActionError, CostWeights, DcgridEnv, DcgridVectorEnv, PrefillDecodeDvfs, ScenarioError
from dcgrid_env.traces import PowerTrace, TraceError
from helpers.in_other_processes import first_rewards

DRAWN = ("dcgrid/Toy6-v0", "dcgrid/IEEE13ThreePhase-v1")
"""A balanced and a three-phase preset: drawing is most of what the checker takes."""


@pytest.mark.parametrize("name", dcgrid_env.IDS)
def test_gymnasium_checker(name):
    check_env(gymnasium.make(name, render_mode="rgb_array").unwrapped, skip_render_check=name not in DRAWN)


@pytest.mark.parametrize("name", dcgrid_env.IDS)
def test_stable_baselines3_checker(name):
    check_sb3_env(gymnasium.make(name).unwrapped)


@pytest.mark.slow
def test_make_without_importing_the_package_first():
    code = "import gymnasium; e = gymnasium.make('dcgrid_env:dcgrid/IEEE123-v0'); print(e.reset(seed=0)[0].shape)"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "(94,)"


def test_overrides_reach_the_scenario():
    env = gymnasium.make("dcgrid/IEEE123-v0", n_datacenters=2, horizon=3, split="test", power_flow="lindistflow")
    assert isinstance(env.unwrapped, DcgridEnv)
    scenario = env.unwrapped.scenario
    assert (scenario.datacenters.count, scenario.horizon, scenario.split) == (2, 3, "test")
    assert env.action_space.shape == (2 * 2 + 7,)
    env.reset(seed=0)
    ends = [env.step(env.action_space.sample())[3] for _ in range(3)]
    assert ends == [False, False, True]


def test_same_seed_same_episode_and_no_seed_goes_on():
    one, two = DcgridEnv("ieee123"), DcgridEnv("ieee123")
    first, info = one.reset(seed=11)
    again, info_again = two.reset(seed=11)
    np.testing.assert_array_equal(first, again)
    assert info == info_again
    next_one, next_two = one.reset()[0], two.reset()[0]
    np.testing.assert_array_equal(next_one, next_two)
    assert not np.array_equal(first, next_one)
    assert not np.array_equal(first, two.reset(seed=12)[0])


def test_split_makes_another_episode_of_the_same_seed():
    first = {s: DcgridEnv("ieee123", split=s).reset(seed=1)[0] for s in ("train", "validation", "test")}
    assert not np.array_equal(first["train"], first["test"])
    assert not np.array_equal(first["train"], first["validation"])
    assert not np.array_equal(first["validation"], first["test"])


def test_rewards_add_up_to_minus_j_times_t_and_info_names_the_terms():
    env = DcgridEnv("ieee33-weak", horizon=25)
    env.reset(seed=5)
    env.action_space.seed(5)
    rewards, info, done = [], {}, False
    while not done:
        _, reward, terminated, truncated, info = env.step(env.action_space.sample())
        terms = sum(info[f"cost_{name}"] for name in env.transition.costs._fields)
        assert reward == pytest.approx(-terms, rel=1e-12)
        assert info["cost"] == info["cost_violation"]
        assert all(math.isfinite(value) for value in info.values())
        rewards.append(reward)
        done = terminated or truncated
    assert len(rewards) == 25
    assert info["cost_leftover"] == pytest.approx(9.0 * info["backlog_kws"] / 3000.0)


def test_info_tells_where_the_agents_stand():
    env = DcgridEnv("ieee33-weak")
    _, info = env.reset(seed=0)
    assert [info[f"bus_{a}"] for a in env.scenario.agents] == [18, 33, 25, 7, 14, 20, 30]


def test_info_keys_are_constant_at_resets_and_at_steps():
    env = DcgridEnv("toy6", horizon=4)
    begun, stepped = set(), set()
    for _ in range(2):
        begun.add(tuple(env.reset(seed=0)[1]))
        stepped |= {tuple(env.step(env.action_space.sample())[-1]) for _ in range(4)}
    (keys,), (more,) = begun, stepped
    buses = [f"bus_{agent}" for agent in env.scenario.agents]
    assert list(keys) == ["power_flow_converged", "voltage_min_pu", "voltage_max_pu", "backlog_kws", "loss_kw", *buses]
    assert [key for key in more if key in keys] == list(keys)
    assert {"J", "cost", "cost_voltage"} <= set(more) - set(keys)


@pytest.mark.parametrize(
    "extra",
    [{}, {"datacenters.clock_law": PrefillDecodeDvfs(), "datacenters.boost_share": 1.3}],
    ids=["linear", "work_classes"],
)
@pytest.mark.slow
def test_save_and_restore_round_trip_exactly(extra):
    env = DcgridEnv("ieee123", **extra)
    env.reset(seed=3)
    env.action_space.seed(3)
    actions = [env.action_space.sample() for _ in range(20)]
    for action in actions[:7]:
        env.step(action)
    saved = env.save()
    course = [env.step(action) for action in actions[7:]]
    env.restore(saved)
    other = DcgridEnv("ieee123", **extra)
    other.restore(saved)
    clone = pickle.loads(pickle.dumps(env))
    copied = copy.deepcopy(env)
    for again in (env, other, clone, copied):
        for action, before in zip(actions[7:], course, strict=True):
            now = again.step(action)
            np.testing.assert_array_equal(now[0], before[0])
            assert now[1:] == before[1:]
    following = [again.reset()[0] for again in (env, other, clone, copied)]
    for observation in following[1:]:
        np.testing.assert_array_equal(observation, following[0])


def test_restore_refuses_what_is_none():
    env = DcgridEnv("toy6")
    other = DcgridEnv("ieee33-weak")
    other.reset(seed=0)
    with pytest.raises(ValueError, match="a scenario with another name"):
        env.restore(other.save())
    longer = DcgridEnv("toy6", horizon=50)
    longer.reset(seed=0)
    with pytest.raises(ValueError, match="another horizon"):
        env.restore(longer.save())
    with pytest.raises(RuntimeError, match="call reset"):  # nothing was taken over
        env.step(np.zeros(4))
    batch = DcgridVectorEnv(2, "toy6")
    batch.reset(seed=0)
    with pytest.raises(ValueError, match="the snapshot has 2 environments, this one 1"):
        env.restore(batch.save())


@pytest.mark.slow
def test_same_episode_in_another_process():
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(first_rewards, (4,)) == first_rewards(4)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.full(17, np.nan), "action of dc_0: clock is nan"),
        (np.r_[np.zeros(16), np.inf], "action of inv_6: q is inf"),
        (np.zeros(3), r"shape \(3,\); it must be \(17,\)"),
        ("up", "no array of numbers"),
    ],
)
def test_bad_actions_are_refused(action, message):
    env = DcgridEnv("ieee123")
    env.reset(seed=0)
    before = env.save()
    with pytest.raises(ActionError, match=message):
        env.step(action)
    assert env.save() is before


def test_actions_out_of_bounds_are_cut():
    env = DcgridEnv("ieee123")
    env.reset(seed=0)
    saved = env.save()
    far = env.step(np.full(17, 1e300))[0]
    env.restore(saved)
    np.testing.assert_array_equal(far, env.step(np.ones(17))[0])


def test_errors_of_use():
    env = DcgridEnv("toy6", horizon=1)
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(env.action_space.sample())
    with pytest.raises(RuntimeError, match="render_mode"):
        env.render()
    env.reset(seed=0)
    env.step(env.action_space.sample())
    with pytest.raises(RuntimeError, match="episode is over"):
        env.step(env.action_space.sample())
    with pytest.raises(ScenarioError, match="no scenario 'ieee124'; did you mean ieee123"):
        DcgridEnv("ieee124")
    words = "no scenario field 'horizn'; did you mean horizon.* unexpected keyword argument 'horizn'"
    with pytest.raises(TypeError, match=words):
        gymnasium.make("dcgrid/IEEE123-v0", horizn=3)
    with pytest.raises(ScenarioError, match="use parallel_env"):
        DcgridEnv("toy6", reward="local")
    with pytest.raises(ValueError, match="render_mode is 'ascii'"):
        DcgridEnv("toy6", render_mode="ascii")


def test_collapse_terminates_and_never_pays():
    step = PowerTrace(np.array([0.0, 10.0, 200.0]), np.array([0.2, 1.0, 1.0]))
    overloaded = {"datacenters.p_rated_kw": 6000.0, "horizon": 40, "trace": (step,), "workload.window": "start"}
    env = DcgridEnv("ieee33-weak", **overloaded)
    env.reset(seed=0)
    rewards, info, terminated, truncated = [], {}, False, False
    while not (terminated or truncated):
        observation, reward, terminated, truncated, info = env.step(np.ones(10))
        assert env.observation_space.contains(observation)
        rewards.append(reward)
    assert (len(rewards), terminated, truncated) == (10, True, False)
    assert info["power_flow_converged"] == 0
    assert 0.9 < info["voltage_min_pu"] < 1.0  # the last voltages that were solved
    assert rewards[-1] < -1000.0 * (40 - 9)  # 31 steps at the largest cost
    slow = DcgridEnv("ieee33-weak", **overloaded)
    slow.reset(seed=0)
    throttled = [slow.step(np.array([-1.0, 1.0] * 3 + [1.0] * 4)) for _ in range(40)]
    assert throttled[-1][3]
    assert sum(rewards) < sum(step[1] for step in throttled)


def test_reset_charges_nothing():
    env = DcgridEnv("ieee33-weak")
    env.reset(seed=0)
    assert all(term.tolist() == [0.0] for term in env.transition.costs)


def test_without_reactive_power_or_data_centres():
    env = DcgridEnv("ieee123", datacenters={"q_max_share": 0.0})
    observation, _ = env.reset(seed=0)
    assert np.isfinite(observation).all()
    env.step(np.ones(17))
    assert (env.transition.state.q_kvar[0, :5] == 0.0).all()
    alone = DcgridEnv("ieee123", n_datacenters=0, weights=CostWeights(clock=1.0, step=1.0, loss=1.0))
    alone.reset(seed=0)
    assert alone.step(np.zeros(7))[1] < 0.0


def test_a_failed_first_reset_leaves_the_next_one_to_work():
    env = DcgridEnv("toy6")
    with pytest.raises(ValueError, match="seed is -1; give a whole number"):
        env.reset(seed=-1)
    env.reset()


def test_what_a_user_writes_into_stays_outside():
    env = DcgridEnv("toy6")
    observation, _ = env.reset(seed=0)
    kept = observation.copy()
    observation[:] = 9.0
    np.testing.assert_array_equal(env.transition.observation[0], kept)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ({"trace": "foo"}, "trace is 'foo'; `dcgrid list traces` lists all"),
        ({"trace": ("inference",)}, "give a source's name, a PowerTrace"),
        ({"weights": {"volts": 1}}, "cost.weights.volts is no field; did you mean voltage"),
        (
            {"datacenters.clock_law": None},
            "datacenters.clock_law is None; give 'linear', 'prefill-decode', 'power-cap', or a clock law",
        ),
        ({"background.capacitors": "no"}, "background.capacitors is 'no'; choose one of True, False"),
        ({"n_datacenters": 2}, "datacenters.count is 2, but .*buses None to have them drawn"),
        ({"datacenters.p_rated_kw": "much"}, "datacenters.p_rated_kw is 'much'; give one positive number"),
        ({"inverters.buses": None}, "inverters.buses is None; give a tuple"),
    ],
)
def test_bad_overrides_name_field_value_and_remedy(override, message):
    with pytest.raises(ScenarioError, match=message):
        gymnasium.make("dcgrid/IEEE33Weak-v0", **override)


def test_a_recording_shorter_than_the_episode_is_refused_where_the_environment_is_made():
    short = PowerTrace(np.arange(100.0), np.ones(100), name="short")
    with pytest.raises(TraceError, match="short"):
        DcgridEnv("ieee33-weak", trace=short)
