"""The commands that tune laws and solve episodes, as a user runs them."""

import json

import pytest

from dcgrid_env import episode_hash, make_scenario, scenario_hash
from dcgrid_env.baselines.hindsight import hindsight
from dcgrid_env.baselines.tune import tune
from dcgrid_env.cli import main


def test_hindsight_writes_what_it_solved_and_goes_on_from_there(tmp_path, capsys):
    arguments = ["hindsight", "--scenarios", "toy6", "--jobs", "1", "--out", str(tmp_path)]
    main([*arguments, "--episodes", "2"])
    path = tmp_path / "toy6.json"
    content = json.loads(path.read_text())
    scenario = make_scenario("toy6", split="test")
    assert content["scenario_hash"] == scenario_hash(scenario)
    assert content["command"] == "dcgrid hindsight --scenarios toy6 --split test --episodes 2"
    found = hindsight(scenario, 1)
    assert content["episodes"][1] == {
        "seed": 1, "hash": episode_hash(scenario, 1), "J": found.J, "bound": found.bound, "rounds": found.rounds,
    }  # fmt: skip
    # What stands in the file is not solved again.
    content["episodes"][0]["J"] = 123.0
    path.write_text(json.dumps(content))
    main([*arguments, "--episodes", "3"])
    again = json.loads(path.read_text())
    assert [e["seed"] for e in again["episodes"]] == [0, 1, 2]
    assert again["episodes"][0]["J"] == 123.0
    assert again["command"].endswith("--episodes 3")
    assert "3 episodes, mean J" in capsys.readouterr().out
    content["scenario_hash"] = "0" * 16
    path.write_text(json.dumps(content))
    with pytest.raises(SystemExit):
        main([*arguments, "--episodes", "3"])
    assert "is of another toy6; move it away, or choose another --out" in capsys.readouterr().err


@pytest.mark.slow
def test_two_processes_solve_what_one_does(tmp_path):
    for jobs in ("1", "2"):
        main(["hindsight", "--scenarios", "toy6", "--episodes", "3", "--jobs", jobs, "--out", str(tmp_path / jobs)])
    one, two = (json.loads((tmp_path / jobs / "toy6.json").read_text())["episodes"] for jobs in ("1", "2"))
    assert one == two


def test_tune_writes_parameters_and_the_command(tmp_path, monkeypatch, capsys):
    arguments = ["tune", "--scenarios", "toy6", "--laws", "droop-q", "--episodes", "1", "--jobs", "1"]
    out = tmp_path / "tuned.json"
    monkeypatch.setattr("sys.argv", ["dcgrid", *arguments])
    main([*arguments, "--out", str(out)])
    content = json.loads(out.read_text())
    assert content["meta"]["command"] == "dcgrid " + " ".join(arguments)
    found = tune("droop-q", [make_scenario("toy6", split="validation")], episodes=1)
    assert content["laws"] == {
        "droop-q": {"toy6": {"parameters": found.parameters, "J": found.score, "trials": found.trials}}
    }
    assert f"k_q_mvar_per_pu_s = {found.parameters['k_q_mvar_per_pu_s']}" in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tune", "--laws", "pid"], "laws is 'pid'; choose among droop, droop-q"),
        (["tune", "--laws", ","], "laws is ','; choose among"),
        (["tune", "--scenarios", "ieee124"], "unknown scenario 'ieee124'; there are toy6"),
        (["tune", "--scenarios", "toy6", "--episodes", "0"], "episodes is 0"),
        (["hindsight", "--scenarios", " , "], "name at least one, or all"),
        (["hindsight", "--scenarios", "toy6", "--episodes", "0"], "episodes is 0"),
        (["hindsight", "--scenarios", "toy6", "--split", "exam"], "split is 'exam'; choose one of"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(arguments, message, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "--out", str(tmp_path / "out")])
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("dcgrid: ")
    assert message in error
    assert not (tmp_path / "out").exists()
