"""Policies with memory: their past observations, the start of an episode, and refused settings."""

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, action_layout, make_scenario
from dcgrid_env.agents import Network, Policy, PolicyError
from dcgrid_env.agents.policy.history_network import HistoryNetwork, with_changes
from dcgrid_env.baselines import rollout

TOY = make_scenario("toy6", horizon=12)


def remembering(seed=0, steps=2):
    """A policy for toy6 whose figures are random."""
    rng = np.random.default_rng(seed)

    def network(n_in, n_out):
        wide = n_in + steps * 2
        first = rng.normal(0.0, 0.3, (wide, 6)), rng.normal(0.0, 0.3, 6)
        layers = [first, (rng.normal(size=(6, n_out)), [0.1] * n_out)]
        return HistoryNetwork(Network(layers, std=np.full(wide, 0.5)), [0, 3], steps)

    return Policy({"datacenter": network(9, 2), "inverter": network(7, 1)}, scenario="toy6")


def test_changes_by_hand():
    columns, memory = np.array([2, 0]), None
    seen = np.array([[[1.0, 9.0, 5.0]], [[2.0, 9.0, 5.5]], [[4.0, 9.0, 5.25]], [[4.0, 9.0, 7.25]]])
    wide = []
    for observation in seen:
        row, memory = with_changes(observation, memory, columns, 2)
        wide.append(row[0].tolist())
    assert wide == [
        [1.0, 9.0, 5.0, 0.0, 0.0, 0.0, 0.0],
        [2.0, 9.0, 5.5, 0.5, 1.0, 0.0, 0.0],
        [4.0, 9.0, 5.25, -0.25, 2.0, 0.5, 1.0],
        [4.0, 9.0, 7.25, 2.0, 0.0, -0.25, 2.0],
    ]


def test_an_episode_begins_where_it_is_reset():
    policy, seen = remembering(), np.random.default_rng(1).uniform(-1.0, 1.0, (3, 5, 23)).astype(np.float32)
    policy.reset(TOY)
    first = [policy.act(observation) for observation in seen]
    assert not np.allclose(policy.act(seen[2]), first[2])
    policy.reset(TOY)
    np.testing.assert_array_equal([policy.act(observation) for observation in seen], first)


def test_environments_do_not_mix():
    policy, seen = remembering(), np.random.default_rng(2).uniform(-1.0, 1.0, (4, 5, 23)).astype(np.float32)
    policy.reset(TOY)
    together = np.array([policy.act(observation) for observation in seen])
    for env_index in range(5):
        policy.reset(TOY)
        alone = [policy.act(observation[env_index]) for observation in seen]
        np.testing.assert_allclose(alone, together[:, env_index], atol=1e-6)


def test_another_number_of_environments_is_refused_until_a_reset():
    policy = remembering()
    policy.reset(TOY)
    policy.act(np.zeros((4, 23), np.float32))
    for other in ((3, 23), (23,)):
        with pytest.raises(PolicyError, match=r"remembers episodes of shape \(4,\) .* call reset\(scenario\)"):
            policy.act(np.zeros(other, np.float32))
    policy.reset(TOY)
    assert policy.act(np.zeros(23, np.float32)).shape == (4,)
    with pytest.raises(PolicyError, match=r"remembers episodes of shape \(\) and"):
        policy.act(np.zeros((3, 23), np.float32))


def test_a_mapping_of_agents_is_the_joint_observation():
    policy = remembering()
    seen = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 23)).astype(np.float32)
    policy.reset(TOY)
    joint = [policy.act(observation) for observation in seen]
    policy.reset(TOY)
    parts = {"dc_0": slice(0, 9), "inv_0": slice(9, 16), "inv_1": slice(16, 23)}
    for observation, action in zip(seen, joint, strict=True):
        own = policy.act({agent: observation[at] for agent, at in parts.items()})
        for agent, expected in action_layout(TOY).split(action).items():
            np.testing.assert_array_equal(own[agent], expected)


def test_it_comes_back_as_it_was_saved(tmp_path):
    policy = remembering()
    policy.save(tmp_path / "one")
    again = Policy.load(tmp_path / "one.safetensors")
    assert again.sha256 == policy.sha256
    assert again.remembers
    costs = [[m["J"] for m in rollout(TOY, which, range(3)).metrics()] for which in (policy, again, policy)]
    assert costs[0] == costs[1] == costs[2]  # a rollout resets, so what a first one left behind does not show


def test_a_native_batch_goes_on_over_episodes():
    policy = remembering()
    env = DcgridVectorEnv(3, TOY)
    observations, _ = env.reset(seed=0)
    policy.reset(TOY)
    for _ in range(TOY.horizon + 2):  # past an automatic reset: nothing but the first steps' changes is of the last one
        observations, *_ = env.step(policy.act(observations))
    assert np.isfinite(observations).all()


@pytest.mark.parametrize(
    ("columns", "steps", "message"),
    [
        ([0], 0, "steps is 0; give a whole number of 1 .. 1000"),
        ([0], True, "steps is True"),
        ([], 1, r"columns are \[\]; give at least one"),
        ([0.5], 1, r"columns are \[0.5\]"),
        ([8], 2, r"columns are \[8\]; with 2 changes of each the network, which takes 10 figures, leaves 8"),
        ([-1], 2, r"columns are \[-1\]"),
        ([0, 1, 2], 5, "leaves -5 to be observed"),
    ],
)
def test_what_does_not_fit_is_named(columns, steps, message):
    network = Network([(np.zeros((10, 1)), [0.0])])
    with pytest.raises(PolicyError, match=message):
        HistoryNetwork(network, columns, steps)
