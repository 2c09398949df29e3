"""A policy on the law's figures: the law itself where its networks give 0, bounded, its file, refusals."""

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, action_layout, make_scenario
from dcgrid_env.agents import ModelAidedPolicy, Network, Policy, PolicyError
from dcgrid_env.agents.policy.law_interface import FEATURES, OUTPUTS, REACTIVE, SERVED
from dcgrid_env.baselines import rollout
from dcgrid_env.baselines.model_aided.model_aided import ModelAided


def giving(value, **law):
    networks = {
        kind: Network([(np.zeros((len(FEATURES[kind]), n)), np.full(n, float(value)))], squash="none")
        for kind, n in OUTPUTS.items()
    }
    return ModelAidedPolicy(networks, law=law, scenario="test", made_with="a test")


@pytest.mark.parametrize("preset", ["das69", "mixed", "zero-shot"])
def test_networks_that_give_0_are_the_law(preset):
    scenario = make_scenario(preset, split="validation", horizon=12)
    law = rollout(scenario, ModelAided(price=0.5), range(2))
    policy = rollout(scenario, giving(0.0, price=0.5), range(2))
    np.testing.assert_array_equal(policy.costs(), law.costs())


@pytest.mark.parametrize("value", [-1e3, 1e3])
def test_corrections_are_bounded(value):
    scenario = make_scenario("ieee33-weak", horizon=8)
    env, law, policy = DcgridVectorEnv(2, scenario), ModelAided(), giving(value)
    observations, _ = env.reset(seed=0)
    law.reset(scenario), policy.reset(scenario)
    is_clock = action_layout(scenario).is_channel("clock")
    for _ in range(8):
        one, other = law.act(observations), policy.act(observations)
        # A kW less of the dynamic rating is 2 / (1 - f_min / f_max) of the clock's range; the top may stand for less.
        slowest = scenario.f_min_mhz / scenario.f_max_mhz
        if value > 0:
            assert (other[:, is_clock] <= one[:, is_clock] + 1e-6).all()
        served = (one - other)[:, is_clock]
        assert (served[one[:, is_clock] < 1.0] <= 2.0 * SERVED / (1.0 - slowest) + 1e-6).all()
        assert abs(other - one)[:, ~is_clock].max() <= REACTIVE + 1e-6
        assert abs(other - one)[:, ~is_clock].max() > 0.0
        observations, *_ = env.step(one)
    env.close()


def test_a_file_of_it_is_read_as_it_was(tmp_path):
    policy = giving(0.3, hold=0.02)
    read = Policy.load(policy.save(tmp_path / "one"))
    assert isinstance(read, ModelAidedPolicy)
    assert (read.sha256, read.law, read.trained_on) == (policy.sha256, policy.law, "test")
    assert read.law["hold"] == 0.02


@pytest.mark.parametrize("law", [{"hold": -1.0}, {"unknown": 1.0}])
def test_settings_that_the_law_has_not_are_refused(law):
    with pytest.raises(PolicyError, match="law is"):
        giving(0.0, **law)


def test_networks_of_other_widths_are_refused():
    with pytest.raises(PolicyError, match="network inverter takes 3 figures"):
        ModelAidedPolicy({"inverter": Network([(np.zeros((3, 1)), np.zeros(1))])})


@pytest.mark.parametrize("preset", ["smoothing", "ieee33-weak-ups"])
def test_what_the_law_refuses_is_refused(preset):
    with pytest.raises(ValueError, match="model-aided"):
        giving(0.0).reset(make_scenario(preset))


def test_drawn_buses_must_be_placed():
    scenario, policy = make_scenario("ieee123"), giving(0.0)
    policy.reset(scenario)
    env = DcgridVectorEnv(1, scenario)
    with pytest.raises(PolicyError, match=r"call place\(buses\) after reset"):
        policy.act(env.reset(seed=0)[0])
    env.close()
