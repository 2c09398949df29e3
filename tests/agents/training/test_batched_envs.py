import numpy as np
import pytest

from dcgrid_env import CostWeights, DcgridVectorEnv, Fault, field_names, make_scenario
from helpers.row_envs import agent_envs, joint_envs

SEED = 5


def scenario(name="ieee33-weak", **overrides):
    return make_scenario(name, horizon=4, **overrides)


def actions_for(vec_env, steps, rng):
    return rng.uniform(-1.2, 1.2, (steps, vec_env.num_envs, vec_env.action_space.shape[0])).astype(np.float32)


def test_joint_rows_are_the_native_environments_steps():
    s = scenario()
    vec_env, native = joint_envs(s, 3), DcgridVectorEnv(3, s)
    vec_env.seed(SEED)
    seen, (expected, _) = vec_env.reset(), native.reset(seed=SEED)
    assert np.array_equal(seen, expected)
    for action in actions_for(vec_env, 6, np.random.default_rng(0)):
        seen, paid, done, _ = vec_env.step(action)
        expected, reward, _, truncated, _ = native.step(action)
        assert np.array_equal(np.asarray(seen), expected)
        assert np.array_equal(paid, reward.astype(np.float32))
        assert np.array_equal(done, truncated)


def test_agent_rows_hold_each_agents_own_observation_by_name_and_the_rest_is_zero():
    s = scenario()
    vec_env, native = agent_envs(s, 2), DcgridVectorEnv(2, s)
    vec_env.seed(SEED)
    seen, (joint, _) = vec_env.reset().reshape(2, s.n_agents, -1), native.reset(seed=SEED)
    assert vec_env.num_envs == 2 * 7
    at = 0
    for i, agent in enumerate(s.agents):
        names = field_names(s)[agent]
        for j, name in enumerate(vec_env.rows.fields):
            expected = joint[:, at + names.index(name)] if name in names else 0.0
            assert np.array_equal(seen[:, i, j], np.broadcast_to(expected, 2)), (agent, name)
        assert (seen[:, i, -1] == (i < 3)).all()  # the kind
        assert np.array_equal(seen[:, i, vec_env.rows.columns(agent)], joint[:, at : at + len(names)])
        at += len(names)
    assert vec_env.observation_space.shape == (len(vec_env.rows.fields) + 1,)


def test_agent_rows_act_as_the_joint_action_and_share_the_reward():
    s = scenario()
    vec_env, native = agent_envs(s, 2), DcgridVectorEnv(2, s)
    vec_env.seed(SEED)
    vec_env.reset()
    native.reset(seed=SEED)
    for action in actions_for(vec_env, 3, np.random.default_rng(1)):
        each = action.reshape(2, 7, 2)
        joint = np.concatenate((each[:, :3].reshape(2, 6), each[:, 3:, 1]), axis=1)  # an inverter's clock goes nowhere
        _, paid, *_ = vec_env.step(action)
        _, reward, *_ = native.step(joint)
        assert np.array_equal(paid.reshape(2, 7), np.repeat(reward[:, None], 7, axis=1).astype(np.float32))
        assert np.array_equal(native.transition.state.f_mhz, vec_env.batch.transition.state.f_mhz)
        assert np.array_equal(native.transition.state.q_kvar, vec_env.batch.transition.state.q_kvar)


def test_nameplate_figures_are_what_full_draw_and_full_reactive_power_do():
    s = scenario()
    vec_env = agent_envs(s, 1, nameplate=True)
    vec_env.seed(SEED)
    seen = vec_env.reset()
    r, x = (seen[:, vec_env.rows.fields.index(name)] for name in ("r", "x"))
    rated_mw = np.array([1.0] * 3 + [0.1] * 4)
    limit_mvar = np.array([0.33] * 3 + [0.1] * 4)
    at = len(vec_env.rows.fields)
    np.testing.assert_allclose(seen[:, at], r * rated_mw, rtol=1e-6)
    np.testing.assert_allclose(seen[:, at + 1], x * limit_mvar, rtol=1e-6)
    assert list(vec_env.rows.columns("inv_0")[-(seen.shape[1] - 1 - at) :]) == list(range(at, seen.shape[1] - 1))


@pytest.mark.parametrize("observe", ["neighbours", "feeder"])
@pytest.mark.parametrize("make", [joint_envs, agent_envs])
def test_observations_lie_in_their_space(make, observe):
    vec_env = make(scenario(observe=observe), 2)
    vec_env.seed(SEED)
    assert vec_env.observation_space.contains(vec_env.reset()[0])
    for action in actions_for(vec_env, 3, np.random.default_rng(2)):
        assert all(vec_env.observation_space.contains(own) for own in vec_env.step(action)[0])


@pytest.mark.parametrize("make", [joint_envs, agent_envs])
def test_an_episodes_end_is_told_as_sb3_wants_it(make):
    vec_env = make(scenario(), 2)
    vec_env.seed(SEED)
    vec_env.reset()
    still = np.zeros((vec_env.num_envs, vec_env.action_space.shape[0]), np.float32)
    for _ in range(3):
        _, _, done, infos = vec_env.step(still)
        assert not done.any()
        assert infos == [{}] * vec_env.num_envs
    seen, _, done, infos = vec_env.step(still)
    assert done.all()
    assert vec_env.truncated.all()
    assert all(info["TimeLimit.truncated"] for info in infos)
    last = np.stack([info["terminal_observation"] for info in infos])
    assert np.array_equal(last, vec_env.arrived())
    assert not np.array_equal(last, seen)


def test_a_voltage_collapse_is_no_truncation():
    s = scenario("ieee33-weak", datacenters={"p_rated_kw": 20000.0})
    vec_env = agent_envs(s, 2)
    vec_env.seed(SEED)
    vec_env.reset()
    _, paid, done, infos = vec_env.step(np.ones((vec_env.num_envs, 2), np.float32))
    assert done.all()
    assert not any(info["TimeLimit.truncated"] for info in infos)
    assert np.isfinite(paid).all()


def test_seeds_begin_the_same_episodes_again_and_episodes_go_on_without():
    vec_env = agent_envs(scenario("ieee123"), 2)
    vec_env.seed(SEED)
    first = vec_env.reset()
    second = vec_env.reset()
    vec_env.seed(SEED)
    assert np.array_equal(vec_env.reset(), first)
    assert np.array_equal(vec_env.reset(), second)
    assert not np.array_equal(first, second)


def test_works_without_either_kind_and_with_faults():
    for s in (scenario(inverters={"buses": ()}), scenario(faults=(Fault(("inverter",), begin_s=(0.0, 1.0)),))):
        vec_env = agent_envs(s, 2)
        vec_env.seed(SEED)
        vec_env.reset()
        vec_env.step(np.zeros((vec_env.num_envs, 2), np.float32))


def test_the_rows_are_one_batch():
    vec_env = agent_envs(scenario(weights=CostWeights()), 2)
    assert vec_env.get_attr("num_envs") == [2] * 14
    assert vec_env.env_is_wrapped(object) == [False] * 14
    with pytest.raises(AttributeError, match="one batch"):
        vec_env.set_attr("x", 1)
    with pytest.raises(AttributeError, match="for a row alone"):
        vec_env.env_method("x")
