"""A policy as a folder for the Hugging Face hub."""

import contextlib
import io
import json
import re
import shutil

import gymnasium
import numpy as np
import pytest
import yaml

from dcgrid_env import make_scenario, scenario_hash
from dcgrid_env.agents import Card, Policy, evaluate
from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.baselines import make_controller
from dcgrid_env.cli.main import main as dcgrid
from docs.studies.commands import main
from docs.studies.publishing.hub_export import export_hub

NAME, ID = "ieee33-weak-analytic", "dcgrid/IEEE33Weak-v0"


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hub") / "policy"
    export_hub(NAME, folder, episodes=4, license="apache-2.0")
    return folder


def metadata_of(folder):
    """Metadata and text of a model card."""
    _, front, text = (folder / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    return yaml.safe_load(front), text


def test_the_card_has_the_figures_of_the_test_split(exported):
    names = ["README.md", "config.json", "policy.json", "policy.safetensors"]
    assert sorted(path.name for path in exported.iterdir()) == names
    about, text = metadata_of(exported)
    assert (about["license"], about["library_name"]) == ("apache-2.0", "dcgrid-env")
    assert {"reinforcement-learning", ID} <= set(about["tags"])
    (model,) = about["model-index"]
    (result,) = model["results"]
    assert (model["name"], result["task"]["type"], result["dataset"]["name"]) == (NAME, "reinforcement-learning", ID)
    test = make_scenario("ieee33-weak", split="test")
    own, droop = (evaluate(each, test, range(4)) for each in (Policy.load(NAME), make_controller("droop-tuned", test)))
    metrics = {metric["type"]: metric["value"] for metric in result["metrics"]}
    assert metrics["J"] == f"{own.J.mean():.4f} +/- {own.J.std():.4f}"
    score = own.score(droop)
    assert metrics["score"] == "{:.3f} ({:.3f} .. {:.3f})".format(*score.score)
    assert "| {:.2f} ({:.2f} .. {:.2f}) |".format(*score.saved_pct) in text
    assert scenario_hash(test) in text
    config = json.loads((exported / "config.json").read_text())
    assert (config["environment"], config["training"]) == (ID, None)
    assert config["policy"]["sha256"] == Policy.load(NAME).sha256


def test_the_reward_is_that_of_the_environment(exported):
    """The sum of rewards of the four episodes, stepped by Gymnasium, gives mean_reward."""
    env, policy, returns = gymnasium.make(ID, split="test"), Policy.load(exported / "policy.safetensors"), []
    for seed in range(4):
        observation, _ = env.reset(seed=seed)
        policy.reset(make_scenario("ieee33-weak"))
        returns.append(0.0)
        ended = False
        while not ended:
            observation, reward, terminated, truncated, _ = env.step(policy.act(observation))
            returns[-1] += float(reward)
            ended = terminated or truncated
    (model,) = metadata_of(exported)[0]["model-index"]
    mean, std = map(float, model["results"][0]["metrics"][0]["value"].split(" +/- "))
    assert mean == pytest.approx(np.mean(returns), abs=0.01)
    assert std == pytest.approx(np.std(returns), abs=0.01)


def test_the_code_in_the_card_runs_in_the_folder(exported, monkeypatch):
    (code,) = re.findall("```python\n(.*?)```", metadata_of(exported)[1], re.DOTALL)
    monkeypatch.chdir(exported)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(code, {})
    test = make_scenario("ieee33-weak", split="test")
    assert float(said.getvalue()) == pytest.approx(evaluate(Policy.load(NAME), test, range(4)).means["J"])


@pytest.mark.slow
def test_the_hub_reads_the_card(exported):
    hub = pytest.importorskip("huggingface_hub", reason="huggingface_hub is not installed; pip install it")
    card = hub.ModelCard.load(exported / "README.md")
    assert card.data.library_name == "dcgrid-env"
    reward, j, score = card.data.eval_results
    assert (reward.metric_type, j.metric_type, score.metric_type) == ("mean_reward", "J", "score")
    assert {one.dataset_type for one in card.data.eval_results} == {ID}
    assert yaml.safe_load(card.data.to_yaml())["model-index"] == metadata_of(exported)[0]["model-index"]


@pytest.mark.slow
def test_a_training_run_is_exported_with_its_configuration(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["--scenario", "toy6", "--set", "horizon=8", "--updates", "1", "--num-envs", "2", "--hidden", "4"]
    dcgrid(["train", "analytic", *words, "--validation-episodes", "2", "--out", "run"])
    main(["export-hub", "run", "--out", "hub", "--episodes", "2", "--scenario", "toy6", "--set", "horizon=8"])
    assert "wrote hub; upload it with the hub's client: hf upload USER/NAME hub" in capsys.readouterr().out
    config = json.loads((tmp_path / "hub" / "config.json").read_text())
    assert config["environment"] is None
    assert (config["training"]["num_envs"], config["training"]["seed"]) == (2, 0)
    assert "out" not in config["training"]
    about, text = metadata_of(tmp_path / "hub")
    assert about["model-index"][0]["results"][0]["dataset"]["name"] == "toy6 --set horizon=8"
    assert "dcgrid evaluate policy.safetensors --scenario toy6 --set horizon=8 --episodes 2" in text
    assert "No score: hindsight costs of these episodes are not stored." in text
    assert Card.load(tmp_path / "hub" / "policy.json").command in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nothing"], "policy: must be the folder of a training run, a .safetensors file or a bundled policy, got"),
        (["droop"], "policy: must be the folder of a training run, a .safetensors file or a bundled policy, got"),
        (["empty"], "policy: there is no file empty/policy.safetensors; give the folder of a completed training run"),
        (["bare.safetensors"], "policy: there is no card bare.json; copy it from where the policy was saved"),
        (["full/own.safetensors"], "scenario: must be given for policy 'full/own.safetensors', which was trained on"),
        ([NAME, "--out", "full"], "out: must be a new or empty folder, got 'full'; choose another folder"),
        ([NAME, "--episodes", "1"], "episodes: must be at least 2 for an interval, got 1"),
        ([NAME, "--license", "MIT License"], "license: must be an identifier of the hub in lower case, got"),
        ([NAME, "--set", "horizon=8"], "set: must be given with --scenario, got horizon=8; add --scenario"),
    ],
)
def test_what_cannot_be_exported_is_one_line(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    shutil.copy(FOLDER / f"{NAME}.safetensors", tmp_path / "bare.safetensors")
    policy = Policy(Policy.load("toy6-analytic").networks, nameplate=True, outputs="change", scenario="mine.toml")
    policy.save(tmp_path / "full" / "own")
    with pytest.raises(SystemExit):
        main(["export-hub", *words, *([] if "--out" in words else ["--out", "hub"])])
    error = capsys.readouterr().err
    assert error.startswith(f"dcgrid: {said}")
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "hub").exists()
