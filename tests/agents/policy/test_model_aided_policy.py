"""A policy on the law's figures: the law itself where its networks give 0, bounded, its file, refusals."""

import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, action_layout, make_scenario
from dcgrid_env.agents import ModelAidedPolicy, Network, Policy, PolicyError
from dcgrid_env.agents.policy.law_interface import FEATURES, OUTPUTS, REACTIVE, SERVED
from dcgrid_env.baselines import rollout
from dcgrid_env.baselines.model_aided.model_aided import ModelAided


def giving(*values, **law):
    """Networks that always give these values, of served power, of the way to u* and of the shift."""
    networks = {
        kind: Network([(np.zeros((len(FEATURES[kind]), n)), np.array(values[-n:], float))], squash="none")
        for kind, n in OUTPUTS.items()
    }
    return ModelAidedPolicy(networks, law=law, scenario="test", made_with="a test")


@pytest.mark.parametrize("preset", ["das69", "mixed", "zero-shot", "robust", "ride-through"])
def test_networks_that_give_0_are_the_law(preset):
    scenario = make_scenario(preset, split="validation", horizon=12)
    law = rollout(scenario, ModelAided(price=0.5), range(2))
    policy = rollout(scenario, giving(0.0, 0.0, 0.0, price=0.5), range(2))
    np.testing.assert_array_equal(policy.costs(), law.costs())


def driven(preset, policy, n_steps=8):
    """Actions of the law and of a policy for the same observations, (step, row, n_action) each."""
    scenario = make_scenario(preset, horizon=n_steps)
    env, law = DcgridVectorEnv(2, scenario), ModelAided()
    observations, _ = env.reset(seed=0)
    law.reset(scenario)
    policy.reset(scenario)
    pairs = []
    for _ in range(n_steps):
        pairs.append((law.act(observations), policy.act(observations)))
        observations, *_ = env.step(pairs[-1][0])
    env.close()
    return np.array(pairs).swapaxes(0, 1)


IS_CLOCK = action_layout(make_scenario("ieee33-weak")).is_channel("clock")


@pytest.mark.parametrize("value", [-1e3, 1e3])
def test_corrections_are_bounded(value):
    by_law, corrected = driven("ieee33-weak", giving(value, 0.0, value))
    q_moved = abs(corrected - by_law)[..., ~IS_CLOCK].max()
    assert 0.0 < q_moved <= REACTIVE + 1e-6
    scenario = make_scenario("ieee33-weak")
    dynamic = 2.0 / (
        1.0 - scenario.datacenters.f_min_mhz / scenario.datacenters.f_max_mhz
    )  # the whole dynamic rating on the clock's scale
    is_cut = by_law[..., IS_CLOCK] < 1.0  # at the top a clock may stand for less
    moved = (by_law - corrected)[..., IS_CLOCK]
    assert (abs(moved[is_cut]) <= SERVED * dynamic + 1e-6).all()
    assert (moved >= -1e-6).all() if value > 0 else (moved <= 1e-6).all()


def test_the_way_to_the_static_optimum_can_be_gone_whole():
    policy = giving(0.0, 1e3, 0.0)
    _, corrected = driven("ieee33-weak", policy)
    known = policy._law.known
    assert known is not None
    best = known.rest_kvar[0, 0] / make_scenario("ieee33-weak").q_scale_kvar
    np.testing.assert_allclose(corrected[..., ~IS_CLOCK], np.broadcast_to(best, (8, 2, len(best))), atol=1e-6)


def test_a_file_of_it_is_read_as_it_was(tmp_path):
    policy = giving(0.3, 0.2, 0.1, hold=0.02)
    read = Policy.load(policy.save(tmp_path / "one"))
    assert isinstance(read, ModelAidedPolicy)
    assert (read.sha256, read.law, read.trained_on) == (policy.sha256, policy.law, "test")
    assert read.law["hold"] == 0.02


@pytest.mark.parametrize("law", [{"hold": -1.0}, {"unknown": 1.0}])
def test_settings_that_the_law_has_not_are_refused(law):
    with pytest.raises(PolicyError, match="law is"):
        giving(0.0, 0.0, 0.0, **law)


def test_networks_of_other_widths_are_refused():
    with pytest.raises(PolicyError, match="network inverter takes 3 figures"):
        ModelAidedPolicy({"inverter": Network([(np.zeros((3, 1)), np.zeros(1))])})


@pytest.mark.parametrize("preset", ["smoothing", "ieee33-weak-ups"])
def test_what_the_law_refuses_is_refused(preset):
    with pytest.raises(ValueError, match="model-aided"):
        giving(0.0, 0.0, 0.0).reset(make_scenario(preset))


def test_drawn_buses_must_be_placed():
    scenario, policy = make_scenario("ieee123"), giving(0.0, 0.0, 0.0)
    policy.reset(scenario)
    env = DcgridVectorEnv(1, scenario)
    with pytest.raises(PolicyError, match=r"call place\(buses\) after reset"):
        policy.act(env.reset(seed=0)[0])
    env.close()
