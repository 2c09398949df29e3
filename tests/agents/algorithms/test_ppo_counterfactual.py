import json
from typing import Any

import numpy as np
import pytest
import torch

from dcgrid_env import DcgridVectorEnv, action_layout, distflow, make_scenario
from dcgrid_env.agents import Policy
from dcgrid_env.agents.algorithms import ppo_counterfactual as algorithm
from dcgrid_env.agents.training.counterfactual import Counterfactual
from dcgrid_env.agents.training.run_folder import TrainingError, read_curve
from dcgrid_env.baselines import rollout

TINY = {"hidden": (8, 8), "validation_episodes": 2, "validate_every": 1, "checkpoint_every": 1, "num_envs": 3}


def tiny(tmp_path, name="run", **fields):
    chosen = {"scenario": "toy6", "out": tmp_path / name, "steps": 900, **TINY, **fields}
    return algorithm.PpoCounterfactual(**chosen)


def without_times(folder):
    times = ("seconds", "physics_s", "learning_s", "validation_s", "steps_per_s")
    return [{name: value for name, value in row.items() if name not in times} for row in read_curve(folder)]


def stepped(scenario, action, seed=0, n_env=2, steps=3):
    """A batch after some steps by an action, and what ``of_step`` takes of the last."""
    batch = DcgridVectorEnv(n_env, scenario, info="none")
    batch.reset(seed=seed)
    joint = np.broadcast_to(action, (n_env, action_layout(scenario).n))
    before = None
    for _ in range(steps):
        before = batch.save()
        batch.step(joint)
    return batch, before, joint


def cost_of_step(batch, before, joint):
    """What the team pays for the step under other joint actions, by the environment itself, without leftover work."""
    batch.restore(before)
    batch.step(joint)
    return batch.transition


@pytest.mark.parametrize("cost", [{}, {"reference": "profile", "profile_band_pu": 0.001}])
@pytest.mark.parametrize("scenario", ["ieee33-weak", "ieee13-3ph-published"])
def test_an_advantage_is_the_difference_that_the_power_flow_makes(scenario, cost):
    """Against the environment's power flow with one setpoint moved; losses, which are left out, are a quarter here."""
    scenario = make_scenario(scenario, background={"load_sigma": 0.0}, cost=cost)
    layout = action_layout(scenario)
    rng = np.random.default_rng(0)
    taken = np.where(layout.is_channel("clock"), 0.2, rng.uniform(-0.4, 0.4, layout.n))
    batch, before, joint = stepped(scenario, taken)
    mean = np.where(layout.is_channel("clock"), 0.5, joint + rng.uniform(-0.1, 0.1, layout.n))
    found = Counterfactual(scenario).of_step(before, batch.transition.state, joint, mean)
    taken_j, w = batch.transition.cost_j, scenario.cost.weights
    rated_kw = scenario.datacenters.parameters.p_rated_kw.sum()
    for entry in range(layout.n):
        other = joint.copy()
        other[:, entry] = mean[:, entry]
        moved = cost_of_step(batch, before, other)
        waiting = moved.state.backlog_kws - cost_of_step(batch, before, joint).state.backlog_kws
        left = w.leftover * waiting.sum(-1) / rated_kw  # put off work is charged at once
        expected = moved.cost_j + left - taken_j
        np.testing.assert_allclose(found[:, entry], expected, rtol=0.3, atol=0.02 * np.abs(found).max())
    assert (np.abs(found[:, layout.is_channel("q")]) > 1e-5).all()
    assert (np.abs(found[:, layout.is_channel("clock")]) > 1e-5).any()


def test_by_hand_on_two_voltages():
    scenario = make_scenario("toy6", background={"load_sigma": 0.0}, workload={"window": "start"})
    batch, before, joint = stepped(scenario, np.zeros(4), n_env=1, steps=1)
    mean = joint.copy()
    mean[0, 2] = -0.5  # inverter 0
    found = Counterfactual(scenario).of_step(before, batch.transition.state, joint, mean)
    state, feeder = batch.transition.state, scenario.feeder
    at, q_kvar = feeder.index(3), 0.5 * scenario.q_scale_kvar[1]
    assert scenario.inverters.buses[0] in (3, "3")
    p, q = feeder.p_load_kw.copy(), feeder.q_load_kvar - feeder.capacitor_kvar
    p[feeder.index(4)] += state.p_kw[0, 0]
    v = distflow(feeder, p, q, scenario.source_voltage_pu).v_pu
    np.testing.assert_allclose(v, state.v_pu[0], atol=1e-6)
    less = q.copy()
    less[at] += q_kvar
    v_mean = distflow(feeder, p, less, scenario.source_voltage_pu).v_pu

    def cost(v):
        away = np.abs(v[1:] - 1.0)
        return 100.0 * away.mean() + 1000.0 * np.maximum(away - 0.05, 0.0).mean()

    expected = cost(v_mean) - cost(v) + 0.02 / 3 * q_kvar / scenario.q_scale_kvar[1]
    assert found[0, 2] == pytest.approx(expected, rel=0.05)
    np.testing.assert_array_equal(found[0, [0, 1, 3]], 0.0)


@pytest.mark.parametrize("scenario", ["ieee33-weak", "mixed", "fault", "ieee34-3ph-published"])
def test_the_mean_action_has_no_advantage(scenario):
    scenario = make_scenario(scenario)
    batch, before, joint = stepped(scenario, 0.3, n_env=3)
    found = Counterfactual(scenario).of_step(before, batch.transition.state, joint, joint)
    np.testing.assert_array_equal(found, 0.0)


def test_rows_with_their_agents_elsewhere_are_judged_each_by_its_own_places():
    scenario = make_scenario("ieee123")
    batch, before, joint = stepped(scenario, 0.3, n_env=3)
    assert before is not None
    mean = joint - 0.1
    buses = before.episode.buses
    assert not (buses == buses[:1]).all()
    together = Counterfactual(scenario).of_step(before, batch.transition.state, joint, mean)
    for env_index in range(3):
        alone, before_alone, own = stepped(scenario, 0.3, seed=env_index, n_env=1)
        found = Counterfactual(scenario).of_step(before_alone, alone.transition.state, own, own - 0.1)
        np.testing.assert_allclose(found[0], together[env_index], rtol=1e-9, atol=1e-12)


def test_what_a_fault_has_taken_has_no_advantage_but_for_its_queue():
    scenario = make_scenario("fault", horizon=70)
    batch, before, joint = stepped(scenario, 0.3, n_env=2, steps=65)
    lost = batch.transition.state.q_limit_kvar == 0.0
    assert lost.any()
    found = Counterfactual(scenario).of_step(before, batch.transition.state, joint, joint - 0.2)
    of_q = found[:, action_layout(scenario).is_channel("q")]
    assert (of_q[lost] == 0.0).all()
    assert (of_q[~lost] != 0.0).any()


def test_within_reach_an_agent_whose_mean_is_far_beyond_its_limit_still_explores(tmp_path):
    limits, spread = {}, {}
    for within_reach in (False, True):
        model = pushing_up(tiny(tmp_path, scenario="mixed", num_envs=2, within_reach=within_reach))
        data, q = model.rollout(8), model.components["q"]
        limits[within_reach] = data.lowest[:, q], data.highest[:, q]
        # From the fourth step on all are at their limits, or where the mean and the exploration have them.
        spread[within_reach] = data.advantages[4 * 2 :, q].std()
        assert data.lowest[:, ~q].isneginf().all()
        assert data.highest[:, ~q].isposinf().all()
        assert ((data.means <= data.highest) & (data.means >= data.lowest)).all()
    assert all(edge.isinf().all() for edge in limits[False])
    assert spread[False] == 0.0
    assert spread[True] > 0.0


def test_within_reach_only_what_leads_back_has_a_derivative(tmp_path):
    model = pushing_up(tiny(tmp_path, scenario="mixed", num_envs=2, within_reach=True))
    data, q = model.rollout(4), model.components["q"]
    for towards, moved in ((1.0, False), (-1.0, True)):
        model.actor.optimizer.zero_grad()
        advantages = torch.where(q, towards * (data.outputs - data.means), 0.0)
        model.loss(data, advantages, torch.arange(len(advantages)))[0].backward()
        grads = [p.grad for net in model.actor.networks.values() for p in net.parameters() if p.grad is not None]
        assert grads
        assert any(bool(grad.any()) for grad in grads) == moved


def pushing_up(cfg):
    """A model whose mean asks for far more reactive power than there is, whatever it sees."""
    vec_env = algorithm.vec_env_for(cfg)
    model = algorithm.make(cfg, vec_env)
    model._last_obs = vec_env.reset()
    with torch.no_grad():
        for net in model.actor.networks.values():
            for parameter in net.parameters():
                parameter.zero_()
            list(net.parameters())[-1].fill_(5.0)
    return model


@pytest.mark.slow
def test_a_killed_run_goes_on_with_the_same_curve_and_the_same_seed_gives_it(tmp_path, monkeypatch):
    whole = algorithm.main(tiny(tmp_path, "whole"))
    learned = algorithm.CounterfactualPpo.update
    count = iter(range(99))

    def killed(model, data):
        if next(count) == 2:
            raise KeyboardInterrupt
        learned(model, data)

    with monkeypatch.context() as patch:
        patch.setattr(algorithm.CounterfactualPpo, "update", killed)
        with pytest.raises(KeyboardInterrupt):
            algorithm.main(tiny(tmp_path, "broken"))
    broken = algorithm.main(tiny(tmp_path, "broken", resume=True))
    assert [row["step"] for row in without_times(whole)] == [300, 600, 900]
    assert without_times(broken) == without_times(whole)
    assert (broken / "policy.safetensors").read_bytes() == (whole / "policy.safetensors").read_bytes()


def test_the_policy_acts_as_the_models_mean_and_sees_no_more_than_an_agent_does(tmp_path):
    cfg = tiny(tmp_path, scenario="ieee33-weak")
    vec_env = algorithm.vec_env_for(cfg)
    model = algorithm.make(cfg, vec_env)
    policy = algorithm.exported(cfg, model)
    policy.reset(vec_env.scenario)
    vec_env.seed(3)
    observed: Any = vec_env.reset()
    for _ in range(3):
        expected, _ = model.predict(observed, deterministic=True)
        np.testing.assert_allclose(policy.act(observed), expected, atol=1e-5)
        observed, *_ = vec_env.step(expected)
    assert policy.observe == "local"
    assert set(policy.networks) == {"datacenter", "inverter"}


@pytest.mark.slow
def test_a_run_keeps_the_best_policy_of_the_curve(tmp_path):
    folder = algorithm.main(tiny(tmp_path, steps=600))
    best = min(row["J"] for row in read_curve(folder))
    found = rollout(make_scenario("toy6", split="validation"), Policy.load(folder / "policy.safetensors"), range(2))
    assert np.mean([m["J"] for m in found.metrics()]) == pytest.approx(best, rel=1e-6)
    card = json.loads((folder / "policy.json").read_text())
    assert (card["algorithm"], card["scenario"]) == ("ppo-counterfactual", "toy6")


def test_nan_stops_the_training(tmp_path, monkeypatch):
    learned = algorithm.CounterfactualPpo.update

    def poisoned(model, data):
        learned(model, data)
        with torch.no_grad():
            model.actor.networks["inverter"].layers[0].bias[0] = float("nan")

    monkeypatch.setattr(algorithm.CounterfactualPpo, "update", poisoned)
    with pytest.raises(TrainingError, match="diverged at step 300: a parameter is not finite"):
        algorithm.main(tiny(tmp_path))


@pytest.mark.slow
def test_it_is_better_than_the_tuned_droop_after_4500_steps(tmp_path):
    cfg = tiny(tmp_path, scenario="ieee33", set=("horizon=30",), steps=4_500, num_envs=15, validate_every=1)
    rows = read_curve(algorithm.main(cfg))
    assert rows[-1]["J"] < 0.9 * rows[-1]["J_droop"]


@pytest.mark.parametrize("scenario", ["ieee34-3ph-published", "scale-32"])
def test_three_phases_and_drawn_buses_run(tmp_path, scenario):
    folder = algorithm.main(tiny(tmp_path, scenario=scenario, set=("horizon=10",), steps=30))
    assert len(read_curve(folder)) == 1


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"q_std": 0.0}, "q_std is 0.0; give more than 0"),
        ({"minibatches": 0}, "minibatches is 0; give more than 0"),
        ({"last_std": 1.5}, "last_std is 1.5; give more than 0 and at most 1"),
        ({"view": "centralised"}, "view is 'centralised'; an advantage is a single agent's: give shared"),
        ({"scenario": "ieee33-weak-ups"}, "devices of kind 'storage'"),
        ({"scenario": "routing"}, "has routing at its devices of kind datacenter, which acts on later steps"),
        ({"scenario": "ride-through"}, "has ride_through at its devices"),
        ({"scenario": "zero-shot"}, "needs the model of one feeder; 'zero-shot' has random ones"),
        ({"set": ("weights={loss=1}",)}, r"does not know what weights.loss = 1 charges; set it to 0"),
        ({"set": ("cost.voltage=bowl",)}, "cost.voltage is 'bowl'; make the scenario with 'l1'"),
    ],
)
def test_what_cannot_be_is_refused_and_leaves_nothing(tmp_path, fields, said):
    with pytest.raises(ValueError, match=said):
        algorithm.main(tiny(tmp_path, **fields))
    assert not (tmp_path / "run").exists()
