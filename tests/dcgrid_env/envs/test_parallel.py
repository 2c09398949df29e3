"""The PettingZoo environment, in its parallel and its AEC form."""

import copy
import pickle

import gymnasium
import numpy as np
import pettingzoo
import pytest
from pettingzoo.test import api_test, max_cycles_test, parallel_api_test, parallel_seed_test, seed_test

import dcgrid_env
from dcgrid_env import ActionError, DcgridEnv, DcgridVectorEnv, PrefillDecodeDvfs, field_names, parallel_env
from helpers.forms import each_preset


@pytest.mark.parametrize("scenario", each_preset())
def test_pettingzoo_checkers(scenario):
    parallel_api_test(parallel_env(scenario), num_cycles=250)
    parallel_seed_test(lambda: parallel_env(scenario), num_cycles=50)
    with pytest.warns(UserWarning, match="different"):
        api_test(dcgrid_env.env(scenario, max_cycles=10), num_cycles=60)  # a data centre and an inverter do differ
    seed_test(lambda: dcgrid_env.env(scenario, max_cycles=10), num_cycles=50)


def test_max_cycles():
    max_cycles_test(dcgrid_env)


@pytest.mark.skipif(not hasattr(pettingzoo, "make"), reason="this release of pettingzoo has no registry")
@pytest.mark.parametrize("name", dcgrid_env.IDS)
def test_pettingzoo_registry(name):
    made = pettingzoo.make("parallel", name, horizon=3)
    assert made.reset(seed=0)[0].keys() == set(made.possible_agents)
    turns = pettingzoo.make("aec", name, max_cycles=3)
    turns.reset(seed=0)
    assert turns.agents == made.possible_agents


def test_agents_are_slots_and_the_bus_stands_in_info():
    env = parallel_env("ieee123")
    assert env.possible_agents == [f"dc_{i}" for i in range(5)] + [f"inv_{i}" for i in range(7)]
    buses = []
    for seed in range(4):
        _, infos = env.reset(seed=seed)
        assert env.agents == env.possible_agents
        assert [infos[f"inv_{i}"]["bus"] for i in range(7)] == [2, 11, 40, 54, 87, 92, 103]
        buses.append(tuple(infos[f"dc_{i}"]["bus"] for i in range(5)))
        assert len(set(buses[-1])) == 5
    assert len(set(buses)) == 4


def test_spaces_are_the_same_objects_and_hold_the_observations():
    env = parallel_env("ieee33-weak")
    observations, _ = env.reset(seed=0)
    for agent in env.agents:
        assert env.observation_space(agent) is env.observation_space(agent)
        assert env.action_space(agent) is env.action_space(agent)
        assert env.action_space(agent).shape == ((2,) if agent.startswith("dc_") else (1,))
        assert env.observation_space(agent).contains(observations[agent])
        space = env.observation_space(agent)
        assert isinstance(space, gymnasium.spaces.Box)
        assert space.is_bounded()
    assert env.state_space.contains(env.state())


def test_same_episode_as_the_single_environment():
    many, one = parallel_env("ieee123"), DcgridEnv("ieee123")
    observations, _ = many.reset(seed=8)
    joint, _ = one.reset(seed=8)
    one.action_space.seed(8)
    for _ in range(20):
        np.testing.assert_array_equal(np.concatenate(list(observations.values())), joint)
        action = one.action_space.sample()
        parts = np.split(action, np.cumsum([2] * 5 + [1] * 6))
        observations, rewards, *_ = many.step(dict(zip(many.agents, parts, strict=True)))
        joint, reward, *_ = one.step(action)
        assert set(rewards.values()) == {reward}


def test_local_reward_pays_each_its_own():
    env = parallel_env("ieee33-weak", reward="local")
    env.reset(seed=0)
    idle = {a: np.r_[1.0, 0.0] if a.startswith("dc_") else np.zeros(1) for a in env.agents}
    _, rewards, *_ = env.step(idle)
    v = env.transition.state.v_agent_pu[0]
    expected = -(100.0 * np.abs(v - 1.0) + 1000.0 * np.maximum(np.abs(v - 1.0) - 0.05, 0.0))
    np.testing.assert_allclose(list(rewards.values()), expected, rtol=1e-12)


def test_difference_rewards_are_the_same_in_all_interfaces():
    many, one = parallel_env("ieee33-weak", reward="difference"), DcgridEnv("ieee33-weak", reward="difference")
    batch = DcgridVectorEnv(2, "ieee33-weak", reward="difference", info="costs")
    _, infos = many.reset(seed=3)
    assert "reward_vector" not in infos["dc_0"]
    one.reset(seed=3)
    batch.reset(seed=3)
    one.action_space.seed(3)
    for _ in range(3):
        action = one.action_space.sample()
        parts = np.split(action, [2, 4, 6, 7, 8, 9])
        _, rewards, *_, infos = many.step(dict(zip(many.agents, parts, strict=True)))
        _, reward, *_, info = one.step(action)
        _, of_batch, *_, of_batch_info = batch.step(np.stack([action, action]))
        vectors = [infos[agent]["reward_vector"] for agent in many.agents]
        assert [len(vector) for vector in vectors] == [2, 2, 2, 1, 1, 1, 1]
        assert list(rewards.values()) == pytest.approx([vector.sum() for vector in vectors], rel=1e-12)
        np.testing.assert_array_equal(info["reward_vector"], np.concatenate(vectors))
        np.testing.assert_array_equal(of_batch_info["reward_vector"][0], info["reward_vector"])
        assert reward == pytest.approx(sum(rewards.values()), rel=1e-12)
        assert of_batch[0] == reward
        assert len(set(rewards.values())) == 7
    plain = parallel_env("ieee33-weak")
    plain.reset(seed=0)
    *_, infos = plain.step({agent: plain.action_space(agent).sample() for agent in plain.agents})
    assert "reward_vector" not in infos["dc_0"]


def test_pettingzoo_checkers_accept_difference_rewards():
    parallel_api_test(parallel_env("ieee33-weak", reward="difference"), num_cycles=130)


def test_global_state_shows_every_bus():
    env = parallel_env("toy6")
    env.reset(seed=0)
    state = env.state()
    v = env.transition.state.v_pu[0, 1:]
    assert state.shape == (5 + 2 * 3 + 2 * 1 + 1,)
    np.testing.assert_allclose(state[:5], (v - 1.0) / 0.05, rtol=1e-5)
    assert state[-1] == 0.0


def test_global_state_shows_both_work_classes():
    env = parallel_env("ieee33-weak", datacenters={"clock_law": PrefillDecodeDvfs()}, trace="mixed")
    observations, _ = env.reset(seed=0)
    for _ in range(8):
        observations, *_ = env.step({a: -np.ones_like(env.action_space(a).sample()) for a in env.agents})
    state, names = env.state(), field_names(env.scenario)
    assert env.state_space.contains(state)
    assert state.shape == (32 + 2 * 7 + 4 * 3 + 1,)
    fields = ("p_ref_next", "backlog", "p_ref_next_compute", "backlog_compute")
    seen = [observations[f"dc_{i}"][names["dc_0"].index(field)] for field in fields for i in range(3)]
    np.testing.assert_allclose(state[32 + 14 : -1], seen, rtol=1e-6)
    assert np.count_nonzero(seen[-3:]) > 0


@pytest.mark.parametrize("scenario", ["toy6", "ieee13-3ph"])  # one with terms of its own in the cost
def test_save_restore_copy_and_pickle(scenario):
    env = parallel_env(scenario, max_cycles=6)
    env.reset(seed=2)
    actions = [{a: env.action_space(a).sample() for a in env.agents} for _ in range(6)]
    for action in actions[:3]:
        env.step(action)
    saved = env.save()
    rest = [env.step(action)[1] for action in actions[3:]]
    assert env.agents == []
    env.restore(saved)
    assert env.agents == env.possible_agents
    for again in (copy.deepcopy(env), pickle.loads(pickle.dumps(env)), env):
        assert [again.step(action)[1] for action in actions[3:]] == rest


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dc_0": np.array([np.nan, 0.0])}, "action of dc_0: clock is nan"),
        ({"inv_1": np.array([np.inf])}, "action of inv_1: q is inf"),
        ({"inv_0": np.zeros(2)}, r"action of inv_0 has shape \(2,\); it must be \(1,\)"),
        ({"dc_9": np.zeros(2)}, r"unknown agents \['dc_9'\]"),
        ({"dc_0": "fast"}, "action of dc_0 has shape"),
    ],
)
def test_bad_actions_name_the_agent(change, message):
    env = parallel_env("toy6")
    env.reset(seed=0)
    actions = {a: env.action_space(a).sample() for a in env.agents}
    with pytest.raises(ActionError, match=message):
        env.step(actions | change)
    with pytest.raises(ActionError, match="must map each of"):
        env.step({"dc_0": actions["dc_0"]})


def test_wider_scopes_and_hidden_preview():
    sizes = {}
    for scope in ("local", "neighbours", "feeder"):
        env = parallel_env(
            "ieee33-weak", observe=scope, sensing={"preview": False, "noise_pu": 0.001, "delay_steps": 2}
        )
        observations, _ = env.reset(seed=0)
        for _ in range(5):
            assert all(env.observation_space(a).contains(o) for a, o in observations.items())
            assert observations["dc_0"][7] == 0.0
            observations, *_ = env.step({a: env.action_space(a).sample() for a in env.agents})
        sizes[scope] = len(observations["inv_0"])
    assert sizes == {"local": 7, "neighbours": 7 + 9, "feeder": 7 + 32}
