import json
import shutil

import numpy as np
import pytest
import torch

from dcgrid_env import DcgridVectorEnv, make_scenario
from dcgrid_env.agents import Policy
from dcgrid_env.agents.algorithms import ppo
from dcgrid_env.agents.training import sb3
from dcgrid_env.agents.training.run_folder import TrainingError, read_curve
from dcgrid_env.baselines import rollout

TINY = {"hidden": (8, 8), "validation_episodes": 2, "validate_every": 1, "checkpoint_every": 1, "num_envs": 6}


def tiny(tmp_path, name="run", **fields):
    return ppo.Ppo(**{"scenario": "toy6", "out": tmp_path / name, "steps": 1200, **TINY, **fields})


def without_times(folder):
    times = ("seconds", "physics_s", "learning_s", "validation_s", "steps_per_s")
    return [{name: value for name, value in row.items() if name not in times} for row in read_curve(folder)]


@pytest.mark.parametrize("view", ["shared", "centralised"])
@pytest.mark.parametrize("act", ["both", "q", "clock"])
def test_the_exported_policy_acts_as_the_models_mean(tmp_path, view, act):
    cfg = tiny(tmp_path, scenario="ieee33-weak", view=view, act=act, nameplate=view == "shared", num_envs=14)
    vec_env = sb3.vec_env_for(cfg)
    model = ppo.make(cfg, vec_env)
    torch.manual_seed(0)
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    policy = ppo.exported(cfg, vec_env, model)
    policy.reset(vec_env.scenario)
    native = DcgridVectorEnv(vec_env.n_envs, vec_env.scenario)
    vec_env.seed(3)
    observed, (joint, _) = vec_env.reset(), native.reset(seed=3)
    for _ in range(5):
        expected, _ = model.predict(np.asarray(observed), deterministic=True)
        action = policy.act(joint)
        observed, *_ = vec_env.step(expected)
        joint, *_ = native.step(action)
        for name in ("f_mhz", "q_kvar"):
            ours, theirs = (getattr(batch.transition.state, name) for batch in (native, vec_env.batch))
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-2)


@pytest.mark.slow
def test_a_run_leaves_what_it_says_and_the_best_policy_is_the_curves(tmp_path):
    folder = ppo.main(tiny(tmp_path))
    assert {"config.json", "curve.csv", "checkpoint.pt", "policy.safetensors", "policy.json"} <= {
        path.name for path in folder.iterdir()
    }
    assert any(path.name.startswith("events.out") for path in folder.iterdir())
    rows = read_curve(folder)
    assert [row["step"] for row in rows] == [600, 1200]
    best = min(row["J"] for row in rows)
    scenario = make_scenario("toy6", split="validation")
    found = rollout(scenario, Policy.load(folder / "policy.safetensors"), range(2)).metrics()
    assert np.mean([m["J"] for m in found]) == pytest.approx(best, rel=1e-6)
    card = json.loads((folder / "policy.json").read_text())
    assert (card["algorithm"], card["scenario"], card["seed"], card["validation_J"]) == ("ppo", "toy6", 0, best)


@pytest.mark.slow
def test_a_killed_run_goes_on_with_the_same_curve_bit_for_bit(tmp_path, monkeypatch):
    whole = ppo.main(tiny(tmp_path, "whole", steps=2400))
    learned = ppo.BatchedPpo.train
    count = iter(range(99))

    def killed(model):
        if next(count) == 2:
            raise KeyboardInterrupt
        learned(model)

    with monkeypatch.context() as patch:
        patch.setattr(ppo.BatchedPpo, "train", killed)
        with pytest.raises(KeyboardInterrupt):
            ppo.main(tiny(tmp_path, "broken", steps=2400))
    broken = ppo.main(tiny(tmp_path, "broken", steps=2400, resume=True))
    assert without_times(broken) == without_times(whole)
    assert len(without_times(whole)) == 4
    assert (broken / "policy.safetensors").read_bytes() == (whole / "policy.safetensors").read_bytes()


@pytest.mark.slow
def test_nan_stops_with_the_step_and_keeps_the_last_good_checkpoint(tmp_path, monkeypatch):
    learned = ppo.BatchedPpo.train

    def poisoned(model):
        learned(model)
        if model.num_timesteps == 1200:
            with torch.no_grad():
                model.policy.action_net.bias[0] = float("nan")

    monkeypatch.setattr(ppo.BatchedPpo, "train", poisoned)
    with pytest.raises(TrainingError, match=r"diverged at step 1200: .*checkpoint\.pt is from before"):
        ppo.main(tiny(tmp_path))
    state = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
    assert state["step"] == 600
    assert all(torch.isfinite(t).all() for t in state["parameters"]["policy"].values())


@pytest.mark.slow
def test_bad_input_is_refused_and_says_what_to_do(tmp_path):
    folder = ppo.main(tiny(tmp_path, steps=600))
    with pytest.raises(TrainingError, match="holds a run already; resume it"):
        ppo.main(tiny(tmp_path, steps=600))
    with pytest.raises(TrainingError, match=r"config\.json: gamma was 0\.9 and is 0\.8 now"):
        ppo.main(tiny(tmp_path, steps=600, gamma=0.8, resume=True))
    cut = folder / "checkpoint.pt"
    cut.write_bytes(cut.read_bytes()[:1000])
    with pytest.raises(TrainingError, match=r"checkpoint\.pt: cut short .* delete it"):
        ppo.main(tiny(tmp_path, steps=600, resume=True))
    shutil.rmtree(folder)


def test_what_reaches_nothing_has_no_likelihood_and_agents_of_an_environment_share_a_value(tmp_path):
    cfg = tiny(tmp_path)
    vec_env = sb3.vec_env_for(cfg)
    policy = ppo.make(cfg, vec_env).policy
    observed = torch.as_tensor(vec_env.reset())
    actions = torch.zeros(6, 2)
    moved = actions.clone()
    moved[:, 0] = 0.7  # the clock; rows are (dc_0, inv_0, inv_1) twice
    with torch.no_grad():
        values, before, _ = policy.evaluate_actions(observed, actions)
        _, after, _ = policy.evaluate_actions(observed, moved)
    assert (before != after).tolist() == [True, False, False, True, False, False]
    assert values.shape == (6, 1)
    assert values[0] == values[1] == values[2] != values[3] == values[4] == values[5]


def test_the_rollout_bootstraps_where_the_horizon_cuts_it_off(tmp_path):
    cfg = tiny(tmp_path, gae_lambda=1.0, gamma=0.5)
    vec_env = sb3.vec_env_for(cfg)
    model = ppo.make(cfg, vec_env)
    vec_env.seed(0)
    model.learn(1)
    buffer = model.rollout_buffer
    assert buffer.full
    paid = buffer.rewards.astype(np.float64)  # the last with gamma V of where the episode was cut off
    returns = np.zeros(6)
    for t in reversed(range(100)):
        returns = paid[t] + 0.5 * returns
        np.testing.assert_allclose(buffer.returns[t], returns, atol=1e-4)


def test_leftover_work_is_charged_over_the_steps_and_a_wait_costs_the_same_under_the_discount():
    price = 0.3 + 9.0 / 120
    undiscounted = sb3.for_training(make_scenario("ieee33-weak"), 1.0, 10.0).cost.weights
    assert undiscounted.leftover == 0.0
    assert undiscounted.backlog == pytest.approx(price)
    raised = sb3.for_training(make_scenario("ieee33-weak"), 0.9, 10.0).cost.weights.backlog
    assert sum(raised * 0.9**k for k in range(10)) == pytest.approx(10.0 * price)


@pytest.mark.slow
def test_it_learns(tmp_path):
    cfg = tiny(tmp_path, "learns", scenario="ieee123", steps=120_000, gamma=0.5, num_envs=96, hidden=(16, 16))
    rows = read_curve(ppo.main(cfg))
    assert rows[-1]["J"] < 0.8 * rows[0]["J"]


@pytest.mark.parametrize("field", ["epochs", "minibatches", "clip", "max_grad_norm"])
def test_a_setting_that_must_be_above_0_is_named(tmp_path, field):
    with pytest.raises(ValueError, match=rf"{field} is 0; give more than 0"):
        ppo.main(tiny(tmp_path, "run", **{field: 0}))
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_difference_rewards_have_settings_of_their_own(tmp_path):
    cfg = ppo.Ppo.for_scenario("toy6", reward="difference", out=tmp_path / "run", steps=1200, **TINY)
    assert (cfg.gamma, cfg.gae_lambda, cfg.outputs, cfg.nameplate) == (0.0, 0.0, "change", True)
    assert cfg.kind == "ppo-difference"
    assert ppo.Ppo.for_scenario("toy6").reward == "shared"
    vec_env = sb3.vec_env_for(cfg, cfg.outputs)
    assert (vec_env.scenario.cost.reward, vec_env.end_as_it_arises) == ("difference", False)
    assert vec_env.scenario.cost.weights == make_scenario("toy6").cost.weights
    assert [row["step"] for row in read_curve(ppo.main(cfg))] == [600, 1200]
    with pytest.raises(
        ValueError, match=r"gamma is 0\.9; a difference reward charges later costs at once: give gamma 0"
    ):
        sb3.vec_env_for(tiny(tmp_path, reward="difference"))
