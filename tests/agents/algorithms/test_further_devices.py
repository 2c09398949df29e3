"""Training with agents and channels other than clock and reactive power: it learns, and saved policies act alike."""

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from dcgrid_env import DcgridVectorEnv, TensorEnv, action_layout, end_costs
from dcgrid_env.agents import Policy, ppo_settings, sb3_vec_env, to_policy
from dcgrid_env.agents.algorithms.analytic import Analytic, Learner
from dcgrid_env.agents.algorithms.safe import require_plain
from helpers.forms import variant_of
from helpers.riding import ride_through_34
from helpers.routing import routed
from helpers.storages import toy6_storage

SCENARIOS = {
    "storages": toy6_storage(20),
    "riding": ride_through_34(horizon=20),
    "routing": routed(horizon=20),
    "set points": variant_of("set points as agents").replace(horizon=20),
}
# They are trained on scenarios of their own, which have no name that a configuration could say.
pytestmark = pytest.mark.filterwarnings("ignore::dcgrid_env.agents.UnseenScenarioWarning")
given = pytest.mark.parametrize("name", SCENARIOS)


SLOW = ("shared", "riding")
"""A view and a scenario whose derivative takes longest."""


@pytest.mark.parametrize(
    ("view", "name"),
    [
        pytest.param(view, name, marks=pytest.mark.slow) if (view, name) == SLOW else (view, name)
        for view in ("shared", "centralised")
        for name in SCENARIOS
        if name != "set points"  # which have no derivative
    ],
)
@pytest.mark.slow
def test_analytic_trains_saves_and_acts_alike(tmp_path, name, view):
    learner = Learner(Analytic(num_envs=4, window=10, hidden=(8,), view=view), [SCENARIOS[name]])
    before = [weight.detach().clone() for weight in learner.networks.parameters()]
    for iteration in (1, 2):
        figures = learner.episodes(0, iteration, lambda what, tensors: None)
        assert np.isfinite(list(figures.values())).all()
    after = list(learner.networks.parameters())
    assert all(not torch.equal(old, new) for old, new in zip(before, after, strict=True))
    policy = Policy.load(learner.policy().save(tmp_path / "policy"))
    env = learner.envs[0]
    policy.reset(env.scenario)
    joint = env.reset(range(3))
    for _ in range(3):
        with torch.no_grad():
            action = learner.act(0, joint)
        np.testing.assert_allclose(policy.act(joint.numpy()), action.numpy(), atol=1e-5)
        joint = env.step(action).observation


@given
def test_sb3_trains_saves_and_acts_alike(tmp_path, name):
    scenario = SCENARIOS[name]
    envs = sb3_vec_env(scenario, 4)
    model = PPO(env=envs, **ppo_settings(envs), seed=0).learn(1)
    policy = Policy.load(to_policy(model, scenario).save(tmp_path / "policy"))
    policy.reset(scenario)
    native = DcgridVectorEnv(4, scenario)
    envs.seed(3)
    rows, (joint, _) = envs.reset(), native.reset(seed=3)
    for _ in range(4):
        rows, *_ = envs.step(model.predict(np.asarray(rows), deterministic=True)[0])
        joint, *_ = native.step(policy.act(joint))
        ours, theirs = (batch.transition.state for batch in (native, envs.batch))
        np.testing.assert_allclose(ours.p_kw, theirs.p_kw, rtol=1e-4, atol=1e-2)
        np.testing.assert_allclose(ours.q_kvar, theirs.q_kvar, rtol=1e-4, atol=1e-2)


def test_the_charge_for_missing_energy_reaches_what_was_done_before():
    """A policy that discharges throughout is led back by the charge at the end alone."""
    scenario = toy6_storage(10)
    env = TensorEnv(scenario, like=torch.empty(0, dtype=torch.float64))
    env.reset([0])
    asked = torch.full((10,), -0.3, dtype=torch.float64, requires_grad=True)
    last = None
    for p in asked:
        still = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
        last = env.step(torch.cat((still, torch.stack((p, p)))).reshape(1, -1))
    assert last is not None
    due = end_costs(scenario, last.state)
    assert due.keys() == {"leftover", "missing"}
    torch.testing.assert_close(due["missing"], last.costs._asdict()["missing"])
    (slope,) = torch.autograd.grad(due["missing"].sum(), asked)
    assert (slope < -0.1).all()  # to discharge less costs less, whenever


def test_safe_training_refuses_what_it_has_no_bound_for():
    with pytest.raises(ValueError, match=r"safe training is made for .* alone; .* kind 'storage'"):
        require_plain(SCENARIOS["storages"])
    with pytest.raises(ValueError, match="of kind datacenter have the channels clock, q, return: train analytic"):
        require_plain(SCENARIOS["riding"])


@pytest.mark.slow
def test_the_surrogate_of_trips_leads_the_channel_of_the_return_and_its_absence_hardly_does():
    """A site that is away feels what returning brings through the surrogate alone."""
    slopes = {}
    for width in (0.0, 0.01):
        learner = Learner(Analytic(num_envs=8, window=40, hidden=(8,), trip_width_pu=width), [ride_through_34()])
        (env,) = learner.envs
        joint = env.reset(range(8))
        asked, total = torch.full((3,), -0.2, requires_grad=True), torch.zeros(())
        returns = torch.tensor(action_layout(env.scenario).is_channel("return"))
        for _ in range(60):
            rest = learner.act(0, joint).detach()
            step = env.step(torch.where(returns, asked[0], rest))
            joint, total = step.observation, total + step.cost_j.mean()
        total.backward()
        assert asked.grad is not None
        slopes[width] = abs(asked.grad[0].item())
    assert slopes[0.0] == 0.0
    assert slopes[0.01] > 0.0
