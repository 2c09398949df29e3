"""Rows of agents of several kinds, and what an episode's end charges spread over the steps."""

from typing import Any

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, action_layout, field_names
from dcgrid_env.agents import sb3_vec_env
from helpers.riding import ride_through_34
from helpers.row_envs import agent_envs, channel_envs, joint_envs
from helpers.storages import toy6_storage


@pytest.mark.parametrize("scenario", [toy6_storage(6), ride_through_34(horizon=6)], ids=["storages", "riding"])
@pytest.mark.parametrize("nameplate", [False, True])
def test_rows_of_every_kind_see_their_own_and_act_as_the_joint_action(scenario, nameplate):
    vec_env, native = agent_envs(scenario, 2, nameplate=nameplate), DcgridVectorEnv(2, scenario)
    vec_env.seed(3)
    rows, (joint, _) = vec_env.reset(), native.reset(seed=3)
    rng, names = np.random.default_rng(0), field_names(scenario)
    for _ in range(4):
        assert all(vec_env.observation_space.contains(row) for row in rows)
        action = rng.uniform(-1.0, 1.0, (vec_env.num_envs, len(vec_env.rows.channels))).astype(np.float32)
        by_agent, own_action = (
            np.asarray(rows).reshape(2, scenario.n_agents, -1),
            action.reshape(2, scenario.n_agents, -1),
        )
        at, given = 0, []
        for i, (agent, device) in enumerate(
            (agent, device)
            for device in scenario.devices
            for agent in scenario.agents
            if agent.startswith(device.prefix)
        ):
            n = len(names[agent])
            np.testing.assert_array_equal(by_agent[:, i, vec_env.rows.columns(agent)[:n]], joint[:, at : at + n])
            given.append(
                own_action[:, i][:, [vec_env.rows.channels.index(channel.name) for channel in device.channels]]
            )
            at += n
        rows, paid, *_ = vec_env.step(action)
        joint, reward, *_ = native.step(np.concatenate(given, axis=1))
        np.testing.assert_array_equal(paid, np.repeat(reward, scenario.n_agents).astype(np.float32))


def test_rows_are_paid_their_difference_rewards_and_an_environment_their_sum():
    scenario = toy6_storage(6).replace(reward="difference")
    rows, joint = agent_envs(scenario, 2), joint_envs(scenario, 2)
    for vec_env in (rows, joint):
        vec_env.seed(3)
        vec_env.reset()
    paid = rows.step(np.full((10, 3), 0.5, np.float32))[1]
    np.testing.assert_array_equal(paid, rows.batch.transition.reward.ravel().astype(np.float32))
    assert len(set(paid.tolist())) == 10
    summed = joint.step(np.full((2, 6), 0.5, np.float32))[1]
    np.testing.assert_allclose(summed, paid.reshape(2, 5).sum(1), rtol=1e-5)


def test_rows_of_channels_act_as_rows_of_agents_and_are_paid_entry_by_entry():
    scenario = toy6_storage(6).replace(reward="difference")
    agents, channels = agent_envs(scenario, 2, outputs="change"), channel_envs(scenario, 2, outputs="change")
    layout, rng = action_layout(scenario), np.random.default_rng(0)
    owner = [scenario.agents.index(agent) for agent, _ in layout.names]
    column = [agents.rows.channels.index(name) for _, name in layout.names]
    for vec_env in (agents, channels):
        vec_env.seed(3)
    of_agents: Any = agents.reset()
    of_channels: Any = channels.reset()
    done, infos = np.zeros(0, bool), []
    for _ in range(6):  # the last step begins new episodes
        assert all(channels.observation_space.contains(row) for row in of_channels)
        by_agent, by_channel = of_agents.reshape(2, 5, -1), of_channels.reshape(2, layout.n, -1)
        np.testing.assert_array_equal(by_channel[..., :-3], by_agent[:, owner])
        np.testing.assert_array_equal(by_channel[..., -3:], np.broadcast_to(np.eye(3)[column], (2, layout.n, 3)))
        action = rng.uniform(-1.0, 1.0, (2, layout.n)).astype(np.float32)
        joined = np.zeros((2, 5, 3), np.float32)
        joined[:, owner, column] = action
        of_agents = agents.step(joined.reshape(10, 3))[0]
        of_channels, paid, done, infos = channels.step(action.reshape(-1, 1))
        vector = channels.batch.transition.reward_vector
        assert vector is not None
        np.testing.assert_array_equal(paid, vector.ravel().astype(np.float32))
    assert done.all()
    assert {info["J"] for info in infos[: layout.n]} == {infos[0]["J"]}
    assert channels.action_space.shape == (1,)


def test_corrections_of_a_droop_are_compared_with_that_droop():
    vec_env = sb3_vec_env(
        "ieee33-weak", 2, "shared", outputs="droop", reward="difference", cost={"default_action": "droop"}
    )
    assert vec_env.scenario.cost.default_gains == vec_env.rows.form.gains
    vec_env.seed(0)
    vec_env.reset()
    for _ in range(3):
        paid = vec_env.step(np.zeros((14, 2), np.float32))[1]
        np.testing.assert_allclose(paid, 0.0, atol=1e-4)  # observations are float32
    assert (np.abs(vec_env.step(np.full((14, 2), -0.3, np.float32))[1]) > 1e-6).any()


def test_kinds_are_told_apart():
    vec_env = agent_envs(toy6_storage(), 1)
    assert vec_env.rows.kinds == ("inverter", "datacenter", "storage")
    assert vec_env.rows.channels == ("clock", "q", "p")
    vec_env.seed(0)
    assert vec_env.reset()[:, -2:].tolist() == [[1, 0], [0, 0], [0, 0], [0, 1], [0, 1]]
