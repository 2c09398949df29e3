import numpy as np
import pytest

from dcgrid_env import DcgridVectorEnv, make_scenario, under_own_control
from dcgrid_env.agents import Policy
from dcgrid_env.agents.policy.interface import PolicyInterface
from dcgrid_env.agents.training.candidates import Candidates
from dcgrid_env.baselines import rollout
from dcgrid_env.baselines.laws.constant_set_points import ConstantSetPoints
from dcgrid_env.traces import PowerTrace


def made(scenario, kind="shared", hidden=(3, 2), outputs="change", law=None):
    """Candidates of a scenario with arbitrary moments."""
    others, rng = under_own_control(scenario), np.random.default_rng(0)
    interface = PolicyInterface(others, kind, outputs=outputs, nameplate=True)
    moments = {
        name: (rng.normal(0.0, 0.1, n_in).astype(np.float32), rng.uniform(0.1, 1.0, n_in).astype(np.float32))
        for name, (n_in, _) in interface.widths.items()
    }
    return Candidates(interface, moments, hidden, scenario, law)


@pytest.mark.parametrize("kind", ["shared", "joint"])
@pytest.mark.parametrize("name", ["ieee33-weak", "ieee13-3ph", "set points"])
def test_each_candidate_costs_what_its_policy_costs_alone(name, kind, tmp_path):
    settings = {"grid_control": {"regulators": "setpoint", "capacitors": "setpoint"}} if name == "set points" else {}
    scenario = make_scenario("ieee13-3ph" if settings else name, horizon=12, **settings)
    seeds = [4, 9, 5]
    candidates = made(scenario, kind)
    start = candidates.start(np.random.default_rng(1))
    parameters = (start + np.random.default_rng(2).normal(0.0, 0.2, (4, len(start)))).astype(np.float32)
    found = candidates.costs(parameters, DcgridVectorEnv(12, scenario, info="none"), seeds)
    assert found.shape == (4, 3)
    assert found.std(0).min() > 1e-3
    for each, of_candidate in zip(parameters, found, strict=True):
        set_points = candidates.set_points(each)
        assert set(set_points) == ({"offset", "half_band", "centre"} if settings else set())
        policy = Policy(candidates.networks(each), nameplate=True, outputs="change", set_points=set_points)
        policy = Policy.load(policy.save(tmp_path / "policy"))
        expected = [metrics["J"] for metrics in rollout(scenario, policy, seeds).metrics()]
        np.testing.assert_allclose(of_candidate, expected, rtol=1e-5)


def test_a_search_around_constants_starts_from_the_law_and_stores_constants_of_each_agent(tmp_path):
    """The start costs what the law costs, and each candidate what its policy costs alone."""
    settings = {"regulators": "setpoint", "capacitors": "setpoint"}
    scenario = make_scenario("ieee13-3ph", horizon=12, grid_control=settings)
    shares = tuple(np.linspace(-0.6, 0.9, under_own_control(scenario).n_agents))
    law = ConstantSetPoints(q_share=shares, offset_v={"reg1": -1.5}, half_band_v={"reg1": 2.5})
    candidates = made(scenario, outputs="constant", law=law)
    start = candidates.start(np.random.default_rng(1))
    drawn = start + np.random.default_rng(2).normal(0.0, 0.2, (4, len(start)))
    parameters = np.concatenate((start[None], drawn)).astype(np.float32)
    found = candidates.costs(parameters, DcgridVectorEnv(10, scenario, info="none"), [4, 9])
    of_law = [metrics["J"] for metrics in rollout(scenario, law, [4, 9]).metrics()]
    np.testing.assert_allclose(found[0], of_law, rtol=1e-5)
    for each, of_candidate in zip(parameters, found, strict=True):
        shares = candidates.q_share(each)
        policy = Policy(
            candidates.networks(each), nameplate=True, outputs="constant", set_points=candidates.set_points(each),
            q_share=None if shares is None else shares.tolist(),
        )  # fmt: skip
        policy = Policy.load(policy.save(tmp_path / "policy"))
        expected = [metrics["J"] for metrics in rollout(scenario, policy, [4, 9]).metrics()]
        np.testing.assert_allclose(of_candidate, expected, rtol=1e-5)


def test_outputs_are_zero_at_the_start():
    scenario = make_scenario("ieee33-weak")
    candidates = made(scenario)
    networks = candidates.networks(candidates.start(np.random.default_rng(0)))
    for name, (n_in, n_out) in candidates.interface.widths.items():
        observation = np.random.default_rng(1).normal(size=(5, n_in))
        np.testing.assert_array_equal(networks[name](observation), np.zeros((5, n_out)))
        assert np.ptp(networks[name].layers[0][0]) > 0.5


def test_an_episode_that_collapses_costs_what_the_rollout_charges():
    """The row begins another episode afterwards, which does not count."""
    step = PowerTrace(np.array([0.0, 10.0, 200.0]), np.array([0.2, 1.0, 1.0]))
    scenario = make_scenario(
        "ieee33-weak", datacenters={"p_rated_kw": 6000.0}, horizon=40, trace=(step,), workload={"window": "start"}
    )
    candidates = made(scenario)
    parameters = np.stack([candidates.start(np.random.default_rng(i)) for i in range(2)]).astype(np.float32)
    found = candidates.costs(parameters, DcgridVectorEnv(4, scenario, info="none"), [0, 1])
    policy = Policy(candidates.networks(parameters[0]), nameplate=True, outputs="change")
    expected = [metrics["J"] for metrics in rollout(scenario, policy, [0, 1]).metrics()]
    assert min(expected) > 0.5 * scenario.cost.weights.violation  # nearly all steps at the largest cost
    np.testing.assert_allclose(found[0], expected, rtol=1e-6)
