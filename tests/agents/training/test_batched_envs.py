import numpy as np
import pytest

from dcgrid_env import CostWeights, DcgridVectorEnv, Fault, field_names, make_scenario
from dcgrid_env.agents.training.agent_lanes import AgentVecEnv
from dcgrid_env.agents.training.batched_envs import JointVecEnv

SEED = 5


def scenario(name="ieee33-weak", **overrides):
    return make_scenario(name, horizon=4, **overrides)


def actions_for(lanes, steps, rng):
    return rng.uniform(-1.2, 1.2, (steps, lanes.num_envs, lanes.action_space.shape[0])).astype(np.float32)


def test_joint_lanes_are_the_native_environments_steps():
    s = scenario()
    lanes, native = JointVecEnv(s, 3), DcgridVectorEnv(3, s)
    lanes.seed(SEED)
    seen, (expected, _) = lanes.reset(), native.reset(seed=SEED)
    assert np.array_equal(seen, expected)
    for action in actions_for(lanes, 6, np.random.default_rng(0)):
        seen, paid, done, _ = lanes.step(action)
        expected, reward, _, truncated, _ = native.step(action)
        assert np.array_equal(np.asarray(seen), expected)
        assert np.array_equal(paid, reward.astype(np.float32))
        assert np.array_equal(done, truncated)


def test_agent_lanes_hold_each_agents_own_observation_by_name_and_the_rest_is_zero():
    s = scenario()
    lanes, native = AgentVecEnv(s, 2), DcgridVectorEnv(2, s)
    lanes.seed(SEED)
    seen, (joint, _) = lanes.reset().reshape(2, s.n_agents, -1), native.reset(seed=SEED)
    assert lanes.num_envs == 2 * 7
    at = 0
    for i, agent in enumerate(s.agents):
        names = field_names(s)[agent]
        for j, name in enumerate(lanes.fields):
            expected = joint[:, at + names.index(name)] if name in names else 0.0
            assert np.array_equal(seen[:, i, j], np.broadcast_to(expected, 2)), (agent, name)
        assert (seen[:, i, -1] == (i < 3)).all()  # the kind
        assert np.array_equal(seen[:, i, lanes.columns(agent)], joint[:, at : at + len(names)])
        at += len(names)
    assert lanes.observation_space.shape == (len(lanes.fields) + 1,)


def test_agent_lanes_act_as_the_joint_action_and_share_the_reward():
    s = scenario()
    lanes, native = AgentVecEnv(s, 2), DcgridVectorEnv(2, s)
    lanes.seed(SEED)
    lanes.reset()
    native.reset(seed=SEED)
    for action in actions_for(lanes, 3, np.random.default_rng(1)):
        each = action.reshape(2, 7, 2)
        joint = np.concatenate((each[:, :3].reshape(2, 6), each[:, 3:, 1]), axis=1)  # an inverter's clock goes nowhere
        _, paid, *_ = lanes.step(action)
        _, reward, *_ = native.step(joint)
        assert np.array_equal(paid.reshape(2, 7), np.repeat(reward[:, None], 7, axis=1).astype(np.float32))
        assert np.array_equal(native.transition.state.f_mhz, lanes.batch.transition.state.f_mhz)
        assert np.array_equal(native.transition.state.q_kvar, lanes.batch.transition.state.q_kvar)


def test_nameplate_figures_are_what_full_draw_and_full_reactive_power_do():
    s = scenario()
    lanes = AgentVecEnv(s, 1, nameplate=True)
    lanes.seed(SEED)
    seen = lanes.reset()
    r, x = (seen[:, lanes.fields.index(name)] for name in ("r", "x"))
    rated_mw = np.array([1.0] * 3 + [0.1] * 4)
    limit_mvar = np.array([0.33] * 3 + [0.1] * 4)
    at = len(lanes.fields)
    np.testing.assert_allclose(seen[:, at], r * rated_mw, rtol=1e-6)
    np.testing.assert_allclose(seen[:, at + 1], x * limit_mvar, rtol=1e-6)
    assert list(lanes.columns("inv_0")[-(seen.shape[1] - 1 - at) :]) == list(range(at, seen.shape[1] - 1))


@pytest.mark.parametrize("observe", ["neighbours", "feeder"])
@pytest.mark.parametrize("make", [JointVecEnv, AgentVecEnv])
def test_observations_lie_in_their_space(make, observe):
    lanes = make(scenario(observe=observe), 2)
    lanes.seed(SEED)
    assert lanes.observation_space.contains(lanes.reset()[0])
    for action in actions_for(lanes, 3, np.random.default_rng(2)):
        assert all(lanes.observation_space.contains(own) for own in lanes.step(action)[0])


@pytest.mark.parametrize(("act", "clock", "q"), [("q", 1410.0, None), ("clock", None, 0.0)])
@pytest.mark.parametrize("make", [JointVecEnv, AgentVecEnv])
def test_what_is_not_in_hand_is_held(make, act, clock, q):
    lanes = make(scenario(), 2, act)
    lanes.seed(SEED)
    lanes.reset()
    lanes.step(np.full((lanes.num_envs, lanes.action_space.shape[0]), -0.5, np.float32))
    state = lanes.batch.transition.state
    assert clock is None or (state.f_mhz == clock).all()
    assert q is None or (state.q_kvar == q).all()
    assert (clock is None) == (state.f_mhz == 510.0).all()
    assert (q is None) == (state.q_kvar < 0).all()


def test_used_entries_follow_kind_and_what_is_in_hand():
    s = scenario()
    assert AgentVecEnv(s, 1).used.tolist() == [[0, 1], [1, 1]]
    assert AgentVecEnv(s, 1, "q").used.tolist() == [[0, 1], [0, 1]]
    assert AgentVecEnv(s, 1, "clock").used.tolist() == [[0, 0], [1, 0]]
    assert JointVecEnv(s, 1, "clock").used.tolist() == [[1, 0] * 3 + [0] * 4]


@pytest.mark.parametrize("make", [JointVecEnv, AgentVecEnv])
def test_an_episodes_end_is_told_as_sb3_wants_it(make):
    lanes = make(scenario(), 2)
    lanes.seed(SEED)
    lanes.reset()
    still = np.zeros((lanes.num_envs, lanes.action_space.shape[0]), np.float32)
    for _ in range(3):
        _, _, done, infos = lanes.step(still)
        assert not done.any()
        assert infos == [{}] * lanes.num_envs
    seen, _, done, infos = lanes.step(still)
    assert done.all()
    assert lanes.truncated.all()
    assert all(info["TimeLimit.truncated"] for info in infos)
    last = np.stack([info["terminal_observation"] for info in infos])
    assert np.array_equal(last, lanes.arrived())
    assert not np.array_equal(last, seen)


def test_a_voltage_collapse_is_no_truncation():
    s = scenario("ieee33-weak", datacenters={"p_rated_kw": 20000.0})
    lanes = AgentVecEnv(s, 2)
    lanes.seed(SEED)
    lanes.reset()
    _, paid, done, infos = lanes.step(np.ones((lanes.num_envs, 2), np.float32))
    assert done.all()
    assert not any(info["TimeLimit.truncated"] for info in infos)
    assert np.isfinite(paid).all()


def test_rewards_are_scaled():
    plain, scaled = AgentVecEnv(scenario(), 1), AgentVecEnv(scenario(), 1)
    scaled.reward_mean, scaled.reward_scale = -2.0, 0.5
    for lanes in (plain, scaled):
        lanes.seed(SEED)
        lanes.reset()
    still = np.zeros((7, 2), np.float32)
    np.testing.assert_allclose(scaled.step(still)[1], 0.5 * (plain.step(still)[1] + 2.0), rtol=1e-6)


def test_seeds_begin_the_same_episodes_again_and_episodes_go_on_without():
    lanes = AgentVecEnv(scenario("ieee123"), 2)
    lanes.seed(SEED)
    first = lanes.reset()
    second = lanes.reset()
    lanes.seed(SEED)
    assert np.array_equal(lanes.reset(), first)
    assert np.array_equal(lanes.reset(), second)
    assert not np.array_equal(first, second)


def test_works_without_either_kind_and_with_faults():
    for s in (scenario(inverters={"buses": ()}), scenario(faults=(Fault(("inverter",), begin_s=(0.0, 1.0)),))):
        lanes = AgentVecEnv(s, 2)
        lanes.seed(SEED)
        lanes.reset()
        lanes.step(np.zeros((lanes.num_envs, 2), np.float32))


def test_the_lanes_are_one_batch():
    lanes = AgentVecEnv(scenario(weights=CostWeights()), 2)
    assert lanes.get_attr("num_envs") == [2] * 14
    assert lanes.env_is_wrapped(object) == [False] * 14
    with pytest.raises(AttributeError, match="one batch"):
        lanes.set_attr("x", 1)
    with pytest.raises(AttributeError, match="for a lane alone"):
        lanes.env_method("x")
