"""Evaluations and their score."""

import sys

import numpy as np
import pytest

from dcgrid_env import field_names, make_scenario
from dcgrid_env.agents import Network, Policy, evaluate
from dcgrid_env.baselines import ConstantQ, Published, make_controller, published, rollout
from dcgrid_env.baselines.score import REFERENCE, score


@pytest.fixture(scope="module")
def test_split():
    return make_scenario("toy6", split="test")


def test_an_evaluation_is_the_means_of_its_episodes(test_split):
    found = evaluate(ConstantQ(0.5), test_split, [4, 2])
    alone = [rollout(test_split, ConstantQ(0.5), [seed]).metrics()[0] for seed in (4, 2)]
    assert found.seeds == (4, 2)
    np.testing.assert_allclose(found.J, [m["J"] for m in alone])
    for name in ("J", "delay_mean_s", "voltage_deviation_mean_pu", "unserved_kws"):
        assert found.means[name] == pytest.approx(np.mean([m[name] for m in alone]))


def test_the_score_is_against_published_hindsight_of_the_same_seeds(test_split):
    seeds = [3, 0, 7]
    droop = evaluate(make_controller(REFERENCE, test_split), test_split, seeds)
    found = evaluate(ConstantQ(0.2), test_split, seeds)
    known = published(test_split)
    assert known is not None
    best = [known.J[list(known.seeds).index(seed)] for seed in seeds]
    assert found.score(droop) == score(found.J, droop.J, best)
    assert droop.score(droop).score.value == 0.0


def test_a_policy_of_another_scope_is_given_it(test_split):
    wide = test_split.replace(observe="feeder")
    names = field_names(wide)
    networks = {
        "datacenter": Network([(np.zeros((len(names["dc_0"]), 2)), [1.0, 0.5])]),
        "inverter": Network([(np.zeros((len(names["inv_0"]), 1)), [0.5])]),
    }
    found = evaluate(Policy(networks, observe="feeder"), test_split, [0, 1])
    np.testing.assert_array_equal(found.J, evaluate(ConstantQ(0.5), test_split, [0, 1]).J)


@pytest.mark.slow
def test_no_score_says_why(test_split):
    validation = make_scenario("toy6", split="validation")

    def told(scenario, seeds, droop_seeds=None):
        own, droop = (evaluate(ConstantQ(0.2), scenario, s) for s in (seeds, droop_seeds or seeds))
        with pytest.raises(ValueError, match="no score: ") as raised:
            own.score(droop)
        return str(raised.value)

    assert "the droop was run on other episodes" in told(test_split, [0, 1], [1, 0])
    assert "not for this toy6 (validation split)" in told(validation, [0, 1])
    assert "not for this toy6 (test split)" in told(test_split.replace(horizon=50), [0, 1])
    assert "published for 100 episodes, not for seed 100" in told(test_split, [99, 100])
    assert "an interval takes at least 2 episodes" in told(test_split, [0])


def test_episodes_that_are_drawn_otherwise_here_have_no_score(test_split, monkeypatch):
    known = published(test_split)
    assert known is not None
    others = Published(known.seeds, known.J, known.bound, ("0" * 16, *known.episode_hashes[1:]))
    module = sys.modules["dcgrid_env.baselines.evaluation"]
    monkeypatch.setattr(module, "published", lambda scenario: others)
    own = evaluate(ConstantQ(0.2), test_split, [0, 1])
    with pytest.raises(ValueError, match="episode 0 of 'toy6', test split, has the hash"):
        own.score(own)
