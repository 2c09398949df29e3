"""A zip of Stable-Baselines3 on the command line: every command takes it as a controller, and unpickles nothing."""

import pytest
import torch
from stable_baselines3 import PPO

from dcgrid_env.agents import Card, Policy, ppo_settings, sb3_vec_env
from dcgrid_env.apps.leaderboard.entries import SUBMISSION, Submission, controller_of, read_record, scenario_of, spec_of
from dcgrid_env.cli.main import main

SHORT = ("--set", "horizon=4")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """An untrained model of the default form, whose actions are about those of the tuned droop, with other weights."""
    envs = sb3_vec_env("toy6", 2, horizon=4)
    file = tmp_path_factory.mktemp("model") / "model.zip"
    trained = PPO(env=envs, seed=3, **ppo_settings(envs))
    with torch.no_grad():
        for parameter in trained.policy.parameters():
            parameter.add_(0.2)
    trained.save(file)
    return str(file)


@pytest.fixture(autouse=True)
def _no_pickles(monkeypatch):
    def refused(*_args, **_kwargs):
        raise AssertionError("something is unpickled")

    monkeypatch.setattr("stable_baselines3.common.save_util.load_from_zip_file", refused)
    monkeypatch.setattr("cloudpickle.loads", refused)


@pytest.mark.parametrize(
    "command",
    [
        ("run", "--scenario", "toy6", "--episodes", "2", *SHORT, "--controllers"),
        ("replay", "--scenario", "toy6", *SHORT, "--compare"),
        ("benchmark", "--scenarios", "toy6", "--episodes", "2", "--jobs", "1", "--controllers"),
        ("capacity", "--feeder", "toy6", "--samples", "2", "--buses", "4", "--jobs", "1", "--controllers"),
    ],
    ids=lambda command: command[0],
)
@pytest.mark.filterwarnings("ignore::dcgrid_env.agents.UnseenScenarioWarning")
def test_commands_take_a_zip(command, model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / ("out.html" if command[0] == "replay" else "out")
    main([*command, model, "--out", str(out)])
    assert any(tmp_path.glob("out*"))


def test_evaluate_takes_the_scenario_of_the_zip_and_shows_the_droop_of_the_same_episodes(model, tmp_path, capsys):
    main(["evaluate", model, "--episodes", "2", "--out", str(tmp_path)])
    printed = capsys.readouterr().out
    assert "toy6, test split, 2 episodes" in printed
    assert "droop-tuned" in printed


def test_a_zip_becomes_a_policy_file_on_the_leaderboard(model, tmp_path, capsys):
    main(["submit", model, "--name", "mine", "--episodes", "2", "--out", str(tmp_path / "entry")])
    assert "which uses no measurements" in " ".join(capsys.readouterr().out.split())
    entry = read_record(tmp_path / "entry" / SUBMISSION, Submission)
    assert (entry.policy, entry.scenario) == ("policy.safetensors", "toy6")
    assert Card.load(tmp_path / "entry" / "policy.json").algorithm == "sb3-ppo"
    assert isinstance(controller_of(spec_of(tmp_path / "entry", entry), scenario_of("toy6")), Policy)


def test_without_torch_the_error_says_what_to_install(model, monkeypatch, capsys):
    monkeypatch.setitem(__import__("sys").modules, "torch", None)
    with pytest.raises(SystemExit) as raised:
        main(["evaluate", model])
    said = capsys.readouterr().err
    assert (raised.value.code, len(said.splitlines())) == (2, 1)
    assert "reading a model needs torch; in a clone of the repository: pip install -e '.[agents]'" in said
