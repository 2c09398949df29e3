import dataclasses

import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Card, Policy
from dcgrid_env.agents.algorithms.affine import Affine, main
from dcgrid_env.agents.algorithms.cem import Search, grid_of
from dcgrid_env.baselines import make_controller, rollout

TINY = Affine("routing", num_envs=64, population=32, elites=6, iterations=8, validation_episodes=4, validate_every=4)


def test_the_search_starts_from_the_tuned_droop_with_few_numbers():
    cfg, test = Affine("ieee33-weak"), make_scenario("ieee33-weak", split="test", horizon=40)
    search = Search(cfg, grid_of(cfg))
    assert len(search.distribution.mean) < 40
    costs = [rollout(test, each, range(2)).costs() for each in (search.policy(), make_controller("droop-tuned", test))]
    assert costs[0] == pytest.approx(costs[1], rel=1e-4)  # the policy has float32


@pytest.mark.slow
def test_the_policy_is_affine_and_better_than_the_droop_on_validation(tmp_path):
    folder = main(dataclasses.replace(TINY, out=tmp_path / "run"))
    policy, card = Policy.load(folder / "policy.safetensors"), Card.load(folder / "policy.json")
    assert (policy.outputs, card.algorithm) == ("droop", "affine")
    assert all(network.settings()["layers"] == 1 for network in policy.networks.values())
    validation = make_scenario("routing", split="validation")
    droop = rollout(validation, make_controller("droop-tuned", validation), range(4)).costs().mean()
    assert card.validation_J < droop
