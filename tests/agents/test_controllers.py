"""Policies by their names, as the registry of controllers finds them."""

import numpy as np
import pytest

from dcgrid_env import make_scenario
from dcgrid_env.agents import Network, Policy, controllers, find_controller
from dcgrid_env.agents.policy import policy as policy_module


@pytest.fixture
def toy6():
    return make_scenario("toy6", split="test", horizon=5)


def test_a_preset_of_another_grid_gets_no_policy_of_the_presets(toy6):
    own = make_scenario("ieee33", datacenters={"p_rated_kw": 900.0})
    with pytest.raises(
        ValueError, match=r"'ppo': the policy that ships for 'ieee33' .* differs in datacenters.p_rated_kw; train"
    ):
        find_controller("ppo", own)
    assert isinstance(
        find_controller("ppo", make_scenario("ieee33", horizon=60, background={"load_sigma": 0.1})), Policy
    )
    assert isinstance(find_controller("ieee33-ppo", own), Policy)


def test_a_trained_policy_by_the_name_that_it_has_on_every_preset(toy6, monkeypatch, tmp_path):
    shipped = ("any-feeder", "ieee33-weak-analytic", "toy6-analytic", "toy6-ppo")
    trained = controllers._trained(shipped)
    assert trained == {"analytic": ("ieee33-weak", "toy6"), "ppo": ("toy6",)}
    policy = Policy({"inverter": Network([(np.zeros((7, 1)), [0.5])])}, scenario="toy6")
    policy.save(tmp_path / "toy6-ppo")
    monkeypatch.setattr(controllers, "TRAINED", trained)
    monkeypatch.setattr(policy_module, "SHIPPED", shipped)
    monkeypatch.setattr(policy_module, "FOLDER", tmp_path)
    for spec in ("ppo", "toy6-ppo"):
        found = find_controller(spec, toy6)
        assert isinstance(found, Policy)
        assert found.sha256 == policy.sha256
    with pytest.raises(ValueError, match="controller 'ppo': none ships for 'ieee123', but for toy6; train one"):
        find_controller("ppo", make_scenario("ieee123"))
