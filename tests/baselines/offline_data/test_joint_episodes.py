"""Episodes of a data set hold what the joint environment gives, bit by bit, whoever acts and in whatever company."""

import gymnasium
import numpy as np
import pytest

from dcgrid_env import DcgridParallelEnv, make_scenario
from dcgrid_env.baselines import Mpc, NoControl, find_controller
from dcgrid_env.baselines.offline_data.behaviour import Planned, RandomActions
from dcgrid_env.baselines.offline_data.joint_episodes import agent_layout, joint_episodes
from dcgrid_env.baselines.offline_data.minari_writer import env_spec


def replayed(scenario, episode):
    """Step the environment of a spec with an episode's actions; all results must equal those of the episode."""
    env = gymnasium.make(env_spec(scenario))
    observation, info = env.reset(seed=episode.seed)
    terminated = truncated = False
    np.testing.assert_array_equal(observation, episode.observations[0])
    for t, action in enumerate(episode.actions):
        observation, reward, terminated, truncated, info = env.step(action)
        np.testing.assert_array_equal(observation, episode.observations[t + 1])
        assert reward == episode.rewards[t]
        assert (terminated, truncated) == (episode.terminations[t], episode.truncations[t])
        assert info.keys() >= episode.infos.keys()
        assert all(np.array_equal(info[name], values[t + 1]) for name, values in episode.infos.items())
    assert terminated or truncated
    assert {agent: str(info[f"bus_{agent}"]) for agent in scenario.agents} == episode.buses


@pytest.mark.parametrize("name", ["ieee33-weak", "ieee123", pytest.param("zero-shot", marks=pytest.mark.slow)])
def test_an_episode_is_the_environments_own_bit_by_bit(name):
    scenario = make_scenario(name, horizon=4)
    episodes = joint_episodes(scenario, find_controller("droop", scenario), [5, 2], noise=0.3)
    assert [episode.seed for episode in episodes] == [5, 2]
    for episode in episodes:
        assert episode.observations.dtype == episode.actions.dtype == np.float32
        assert len(episode.observations) == 1 + len(episode.actions) == 5
        replayed(scenario, episode)


def test_difference_rewards_are_stored_for_each_channel_and_as_their_sum():
    scenario = make_scenario("ieee33-weak", horizon=4, reward="difference")
    (episode,) = joint_episodes(scenario, find_controller("droop", scenario), [5], noise=0.3)
    assert episode.infos["reward_vector"].shape == (5, 10)
    np.testing.assert_allclose(episode.rewards, episode.infos["reward_vector"][1:].sum(-1))
    replayed(scenario, episode)


def test_an_episode_that_ends_in_collapse_ends_there():
    scenario = make_scenario("ieee33-weak", horizon=4, source_voltage_pu=0.55)
    (episode,) = joint_episodes(scenario, NoControl(), [0])
    assert episode.terminations[-1]
    replayed(scenario, episode)


@pytest.mark.parametrize("random", [False, True])
def test_what_is_drawn_does_not_depend_on_the_other_episodes(random):
    scenario = make_scenario("ieee33-weak", horizon=3)

    def actions(seeds, behaviour_seed):
        controller = RandomActions(seeds, behaviour_seed) if random else NoControl()
        chosen = {"noise": 0.0 if random else 0.2, "behaviour_seed": behaviour_seed}
        return joint_episodes(scenario, controller, seeds, **chosen)[-1].actions

    alone, beside, other = actions([7], 0), actions([3, 7], 0), actions([7], 1)
    np.testing.assert_array_equal(alone, beside)
    assert not np.array_equal(alone, other)
    assert np.abs(alone).max() <= 1.0
    assert len(np.unique(alone)) > 10


def test_plans_are_played_as_they_are():
    scenario = make_scenario("ieee33-weak", horizon=3)
    plans = np.linspace(-1.0, 1.0, 2 * 3 * 10).reshape(2, 3, 10)
    episodes = joint_episodes(scenario, Planned(plans), [0, 1])
    np.testing.assert_array_equal([episode.actions for episode in episodes], plans.astype(np.float32))


def test_a_controller_that_sees_more_than_the_data_would_hold_is_refused():
    with pytest.raises(ValueError, match=r"observes 'feeder'.*would hold 'local'.*observe to 'feeder'"):
        joint_episodes(make_scenario("ieee33-weak", horizon=2), Mpc(), [0], name="mpc")


def test_the_layout_says_where_each_agent_stands():
    scenario = make_scenario("ieee33-weak", horizon=2)
    (episode,) = joint_episodes(scenario, NoControl(), [0])
    many = DcgridParallelEnv(scenario)
    own, _ = many.reset(seed=0)
    layout = agent_layout(scenario)
    assert list(layout) == list(scenario.agents)
    for agent, at in layout.items():
        np.testing.assert_array_equal(episode.observations[0, slice(*at["observation"])], own[agent])
        assert at["action"][1] - at["action"][0] == len(at["channels"]) == len(many.action_space(agent).sample())
        assert len(at["fields"]) == len(own[agent])
