"""Trainings with Stable-Baselines3: their files, and that they resume."""

import json

import numpy as np
import pytest
import torch

from dcgrid_env import make_scenario
from dcgrid_env.agents import Policy
from dcgrid_env.agents.algorithms import sb3
from dcgrid_env.agents.training.run_folder import Run, TrainingError, read_curve
from dcgrid_env.baselines import rollout

KINDS = {"ppo": sb3.Ppo, "sac": sb3.Sac, "td3": sb3.Td3}


def tiny(tmp_path, name="ppo", folder="run", **fields):
    chosen = {"scenario": "toy6", "set": ("horizon=30",), "num_envs": 2, "steps": 240, "validate_every": 60}
    return KINDS[name](**(chosen | {"validation_episodes": 2, "out": tmp_path / folder} | fields))


def without_times(folder):
    return [{name: value for name, value in row.items() if name != "seconds"} for row in read_curve(folder)]


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_a_killed_run_resumes_with_the_same_curve_and_its_best_policy_is_kept(tmp_path, monkeypatch, name):
    whole, saved, count = sb3.main(tiny(tmp_path, name, "whole")), Run.save, iter(range(9))

    def killed(run, state):
        saved(run, state)
        if next(count) == 1:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Run, "save", killed)
        with pytest.raises(KeyboardInterrupt):
            sb3.main(tiny(tmp_path, name, "broken"))
    broken = sb3.main(tiny(tmp_path, name, "broken", resume=True))
    curve = without_times(whole)
    assert without_times(broken) == curve
    assert [row["step"] for row in curve] == [60, 120, 180, 240]
    assert (broken / "policy.safetensors").read_bytes() == (whole / "policy.safetensors").read_bytes()
    best = min(row["J"] for row in curve)
    scenario = make_scenario("toy6", split="validation", horizon=30)
    costs = rollout(scenario, Policy.load(whole / "policy.safetensors"), range(2)).costs()
    assert np.mean(costs) == pytest.approx(best, rel=1e-6)
    card = json.loads((whole / "policy.json").read_text())
    assert (card["algorithm"], card["scenario"], card["validation_J"]) == (name, "toy6 --set horizon=30", best)
    before = (broken / "curve.csv").read_bytes()
    sb3.main(tiny(tmp_path, name, "broken", resume=True))  # nothing is left to do
    assert (broken / "curve.csv").read_bytes() == before


@pytest.mark.slow
def test_parameters_that_are_not_finite_end_the_run_and_the_checkpoint_before_is_kept(tmp_path, monkeypatch):
    learned = sb3.PPO.train

    def poisoned(model):
        learned(model)
        if model.num_timesteps >= 120 * 4:  # of four channels
            with torch.no_grad():
                model.policy.action_net.bias[0] = float("nan")

    monkeypatch.setattr(sb3.PPO, "train", poisoned)
    with pytest.raises(TrainingError, match=r"diverged at step 120: .*checkpoint\.pt is from before"):
        sb3.main(tiny(tmp_path))
    state = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
    assert (state["step"], state["stage"]) == (60, 1)
    with pytest.raises(TrainingError, match="holds a run already; resume it"):
        sb3.main(tiny(tmp_path))
    with pytest.raises(TrainingError, match=r"config\.json: view was None and is 'shared' now"):
        sb3.main(tiny(tmp_path, view="shared", resume=True))


def test_options_choose_rows_and_reward(tmp_path):
    usual = sb3.vec_env_for(tiny(tmp_path))
    assert (usual.rows.form.view, usual.scenario.cost.reward) == ("channel", "difference")
    cfg = tiny(tmp_path, out=None, view="shared", outputs="droop", reward="shared")
    chosen = sb3.vec_env_for(cfg)
    assert (chosen.rows.form.view, chosen.rows.form.outputs, chosen.scenario.cost.reward) == (
        "shared", "droop", "shared",
    )  # fmt: skip
    assert (tiny(tmp_path).kind, cfg.folder.name) == ("ppo", "toy6-ppo-shared-droop-shared-0")
    with pytest.raises(ValueError, match="steps is 0; give more than 0"):
        sb3.vec_env_for(tiny(tmp_path, steps=0))
