"""The commands that tune laws and solve episodes, as a user runs them."""

import json
import os
import signal
import subprocess
import sys
import time
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import pytest

from dcgrid_env import episode_hash, make_scenario, scenario_hash
from dcgrid_env.baselines import make_controller, published, rollout
from dcgrid_env.baselines.hindsight_costs import FOLDER
from dcgrid_env.baselines.model_based.hindsight import hindsight
from dcgrid_env.baselines.scenario_spec import ScenarioSpec
from dcgrid_env.baselines.tuning import search
from dcgrid_env.baselines.tuning.search import Tuned, tune
from dcgrid_env.cli.main import main
from helpers.places import ROOT


@pytest.mark.slow
def test_hindsight_writes_what_it_solved_and_goes_on_from_there(tmp_path, capsys):
    arguments = ["hindsight", "--scenarios", "toy6", "--workers", "1", "--out", str(tmp_path)]
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
    assert (
        "belongs to a different scenario named toy6; move the file, or choose another --out" in capsys.readouterr().err
    )


@pytest.mark.slow
def test_costs_far_above_their_bound_are_called_best_known(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = ("horizon=20", 'grid_control.regulator_settings={timer="integrating"}')
    arguments = ["hindsight", "--scenarios", "ieee13-3ph-published", "--set", *settings, "--workers", "1"]
    main([*arguments, "--episodes", "1"])
    scenario = ScenarioSpec("ieee13-3ph-published", settings).make("test")
    main([*arguments, "--episodes", "2"])  # goes on from a file with bounds
    values, content = published(scenario, FOLDER), json.loads((FOLDER / "ieee13-3ph-published.json").read_text())
    assert values is not None
    assert values.is_best_known
    assert content["kind"] == "best known"
    assert (values.bound < values.J * (1.0 - 1e-3)).all()
    assert "2 above 0.001 of J" in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.slow
def test_best_known_costs_are_of_the_other_command(tmp_path, capsys):
    written = ROOT / "baselines" / "data" / "hindsight" / "ride-through.json"
    (tmp_path / written.name).write_bytes(written.read_bytes())
    with pytest.raises(SystemExit, match="2"):
        main(["hindsight", "--scenarios", "ride-through", "--episodes", "1", "--out", str(tmp_path)])
    assert capsys.readouterr().err.endswith("ride-through.json contains best known costs; choose another --out\n")


@pytest.mark.slow
def test_two_processes_solve_what_one_does(tmp_path):
    for jobs in ("1", "2"):
        main(
            [
                "hindsight",
                "--scenarios",
                "toy6",
                "--episodes",
                "3",
                "--workers",
                jobs,
                "--out",
                str(tmp_path / jobs),
            ]
        )
    one, two = (json.loads((tmp_path / jobs / "toy6.json").read_text())["episodes"] for jobs in ("1", "2"))
    assert one == two


@pytest.mark.slow
def test_tune_writes_parameters_and_the_command_and_leaves_the_rest(tmp_path, capsys):
    out = tmp_path / "tuned.json"
    other = {"droop-q": {"mine": {"parameters": {}}}, "droop": {"toy6": {"parameters": {}}}}
    out.write_text(json.dumps({"laws": other}))
    command = "dcgrid tune --laws droop-q --scenarios toy6 --episodes 1"
    main([*command.split()[1:], "--workers", "1", "--out", str(out)])
    laws = json.loads(out.read_text())["laws"]
    found = tune("droop-q", [make_scenario("toy6", split="validation")], episodes=1)
    record = {"parameters": found.parameters, "J": found.score, "trials": found.trials, "command": command}
    record["spectral_radius"] = found.spectral_radius
    assert laws == {"droop": other["droop"], "droop-q": other["droop-q"] | {"toy6": record}}
    assert f"k_q_mvar_per_pu_s = {found.parameters['k_q_mvar_per_pu_s']}" in capsys.readouterr().out.replace("\n", " ")


@pytest.mark.slow
def test_offsets_of_controlled_regulators_are_printed_as_an_option_that_the_tuned_law_requires(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(search, "CANDIDATES", 8)
    monkeypatch.setattr(search, "ITERATIONS", 2)
    monkeypatch.chdir(tmp_path)
    option = 'grid_control.regulator_settings={timer="reset"}'
    arguments = ["tune", "--laws", "static", "--scenarios", "ieee13-3ph", "--set", option, "--episodes", "1"]
    main([*arguments, "--workers", "1"])
    entry = json.loads(Path("results/tuned.json").read_text())["laws"]["static"]["ieee13-3ph"]
    (required,) = entry["set"]
    printed = "".join(capsys.readouterr().out.split())
    assert f"setinthescenario:--set'{required}'".replace(" ", "") in printed
    before, after = (ScenarioSpec("ieee13-3ph", (text,)).make("validation") for text in (option, required))
    assert before.grid_control.regulator_settings.timer == after.grid_control.regulator_settings.timer == "reset"
    assert rollout(after, make_controller("static-tuned", after), [0]).costs().mean() == pytest.approx(entry["J"])
    with pytest.raises(ValueError, match=r"static: offset_v of 'reg1' is .* add --set 'grid_control"):
        make_controller("static-tuned", before).reset(before)


def test_tune_keeps_each_law_as_it_is_found_and_goes_on_from_there(tmp_path, capsys, monkeypatch):
    out = tmp_path / "made" / "tuned.json"
    arguments = ["tune", "--laws", "constant-q,droop-q", "--scenarios", "ieee123,toy6", "--episodes", "1"]
    arguments += ["--workers", "1", "--out", str(out)]
    searched = _searches(monkeypatch, stop_at=3)
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 130
    assert capsys.readouterr().err.splitlines() == ["dcgrid: interrupted; run the same command again to resume"]
    laws = json.loads(out.read_text())["laws"]
    assert {law: list(entries) for law, entries in laws.items()} == {"droop-q": ["ieee123"], "constant-q": ["ieee123"]}
    laws["droop-q"]["ieee123"]["J"] = 123.0
    laws["placement"] = {"mine": {"parameters": {}}}
    out.write_text(json.dumps({"laws": laws}))
    searched.clear()
    main(arguments)
    assert searched == [("constant-q", ("toy6",)), ("droop-q", ("toy6",))]
    assert "kept 2 of 4 results that are already in" in capsys.readouterr().out
    laws = json.loads(out.read_text())["laws"]
    # Laws in the order in which they can be tuned, scenarios in that of the presets.
    ordered = {"droop-q": ["toy6", "ieee123"], "constant-q": ["toy6", "ieee123"], "placement": ["mine"]}
    assert [(law, list(entries)) for law, entries in laws.items()] == list(ordered.items())
    assert laws["droop-q"]["ieee123"]["J"] == 123.0


def test_tune_searches_anew_what_another_command_found_or_what_is_asked_for_again(tmp_path, monkeypatch, capsys):
    out = tmp_path / "tuned.json"
    arguments = [
        "tune",
        "--laws",
        "droop-q",
        "--scenarios",
        "toy6",
        "--workers",
        "1",
        "--out",
        str(out),
        "--episodes",
    ]
    searched = _searches(monkeypatch)
    for more in (["1"], ["1"], ["2"], ["2", "--again"]):
        main([*arguments, *more])
    assert len(searched) == 3
    assert "nothing to do: all results are already in" in capsys.readouterr().out
    assert json.loads(out.read_text())["laws"]["droop-q"]["toy6"]["command"].endswith("--episodes 2")
    monkeypatch.setattr("dcgrid_env.baselines.tuning.search.tune", _interrupted)
    with pytest.raises(SystemExit):
        main([*arguments, "2", "--again"])
    # The same command would search all anew.
    assert capsys.readouterr().err.splitlines() == ["dcgrid: interrupted"]


def _searches(monkeypatch, stop_at=None):
    """Let no search be done; the laws and scenarios that were asked for. The one numbered ``stop_at`` is cut off."""
    asked = []

    def search(law, scenarios, episodes):
        asked.append((law, tuple(scenario.name for scenario in scenarios)))
        if len(asked) == stop_at:
            raise KeyboardInterrupt
        return Tuned({"gain": 1.0}, 2.0, 3)

    monkeypatch.setattr("dcgrid_env.baselines.tuning.search.tune", search)
    return asked


def _interrupted(*_, **__):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: path.mkdir(), "out: must be a file, got the folder"),
        (lambda path: path.write_text("{"), "pass a file that dcgrid tune wrote"),
        (lambda path: path.write_text('{"laws": []}'), "is not a file of tuned parameters"),
        (lambda path: path.write_text('{"laws": {"droop": {"toy6": {}}}}'), "is not a file of tuned parameters"),
        (lambda path: path.parent.write_text(""), "a folder that can be created"),
    ],
)
def test_an_out_that_tune_cannot_write_is_refused_before_any_search(make, message, tmp_path, capsys, monkeypatch):
    searched = _searches(monkeypatch)
    out = tmp_path / "folder" / "out"
    if message != "a folder that can be created":
        out.parent.mkdir()
    make(out)
    with pytest.raises(SystemExit) as stopped:
        main(["tune", "--laws", "droop-q", "--scenarios", "toy6", "--out", str(out)])
    _is_one_line(stopped, capsys, message)
    assert not searched


def test_an_interrupted_hindsight_keeps_its_episodes(tmp_path, capsys, monkeypatch):
    _solutions(monkeypatch, stop_at=3)
    arguments = ["hindsight", "--scenarios", "toy6", "--workers", "1", "--out", str(tmp_path), "--episodes", "4"]
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 130
    assert capsys.readouterr().err.splitlines() == ["dcgrid: interrupted; run the same command again to resume"]
    assert [e["seed"] for e in json.loads((tmp_path / "toy6.json").read_text())["episodes"]] == [0, 1]


def _solutions(monkeypatch, stop_at=None, **of_seed):
    """Let no episode be solved; ``of_seed`` gives (J, bound, rounds) for some, as s3=...."""
    asked = []

    def solve(scenario, seed, *_):
        asked.append(seed)
        if len(asked) == stop_at:
            raise KeyboardInterrupt
        return Solved(*of_seed.get(f"s{seed}", (1.0, 1.0, 2)))

    monkeypatch.setattr("dcgrid_env.baselines.model_based.hindsight.hindsight", solve)


class Solved(NamedTuple):
    J: float
    bound: float
    rounds: int


def test_the_command_in_the_file_asks_for_all_its_episodes(tmp_path, capsys, monkeypatch):
    # Seed 1 has the largest gap, below the bound; 1 and 2 stopped at six programs, of which 2 agrees.
    _solutions(monkeypatch, s1=(2.0, 2.5, 6), s2=(1.0, 1.0, 6), s3=(4.0, 3.9, 5))
    arguments = ["hindsight", "--scenarios", "toy6", "--workers", "1", "--out", str(tmp_path), "--episodes"]
    main([*arguments, "8"])
    said = " ".join(capsys.readouterr().out.split())
    assert "8 episodes, mean J 1.5000, largest gap to the bound 2.5e-01 of J, 1 stopped after 6 programs with a" in said
    assert "missing" not in said
    path = tmp_path / "toy6.json"
    content = json.loads(path.read_text())
    content["episodes"] = [e for e in content["episodes"] if e["seed"] in (0, 7)]
    path.write_text(json.dumps(content))
    main([*arguments, "2"])
    content = json.loads(path.read_text())
    assert [e["seed"] for e in content["episodes"]] == [0, 1, 7]
    assert content["command"] == "dcgrid hindsight --scenarios toy6 --split test --episodes 8"
    assert "5 of the seeds 0 to 7 are missing" in " ".join(capsys.readouterr().out.split())


WHOLE = {"seed": 0, "hash": "0" * 16, "J": 1.0, "bound": 1.0, "rounds": 2}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("{}", "has no 'scenario_hash' and 'episodes'"),
        ("[]", "has no 'scenario_hash' and 'episodes'"),
        ({}, "has 'episodes' that are no list"),
        ([1], "has no record in its episode at place 0"),
        ([WHOLE, {k: v for k, v in WHOLE.items() if k != "J"}], "has no 'J' in its episode at place 1"),
        ([WHOLE | {"bound": float("nan")}], "has bound = nan in its episode at place 0"),
        ([WHOLE | {"seed": "0"}], "has seed = '0' in its episode at place 0"),
    ],
)
def test_a_damaged_file_is_named(text, message, tmp_path, capsys):
    path = tmp_path / "toy6.json"
    if not isinstance(text, str):
        about = scenario_hash(make_scenario("toy6", split="test"))
        text = json.dumps({"scenario_hash": about, "episodes": text})
    path.write_text(text)
    with pytest.raises(SystemExit) as stopped:
        main(["hindsight", "--scenarios", "toy6", "--episodes", "1", "--out", str(tmp_path)])
    _is_one_line(stopped, capsys, str(path), message, "; delete it, or choose another --out")
    assert path.read_text() == text


def test_an_out_that_hindsight_cannot_write_is_refused_at_once(tmp_path, capsys, monkeypatch):
    _solutions(monkeypatch, stop_at=1)
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit) as stopped:
        main(["hindsight", "--scenarios", "toy6", "--workers", "1", "--out", str(tmp_path / "file")])
    _is_one_line(stopped, capsys, "a folder that can be created")


def _is_one_line(stopped, capsys, *messages):
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("dcgrid: ")
    assert len(error.strip().splitlines()) == 1
    for message in messages:
        assert message in error


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
def test_ctrl_c_with_two_processes_is_one_line(tmp_path):
    arguments = [
        "hindsight",
        "--scenarios",
        "toy6",
        "--episodes",
        "100",
        "--workers",
        "2",
        "--out",
        str(tmp_path),
    ]
    started = subprocess.Popen(
        [sys.executable, "-m", "dcgrid_env.cli.main", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    path, until = tmp_path / "toy6.json", time.monotonic() + 60.0
    while not path.exists() and time.monotonic() < until:
        time.sleep(0.02)
    os.killpg(started.pid, signal.SIGINT)
    _, error = started.communicate(timeout=60)
    assert started.returncode == 130, error
    assert error.splitlines() == ["dcgrid: interrupted; run the same command again to resume"]
    assert json.loads(path.read_text())["episodes"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tune", "--laws", "pid"], "laws: no tunable law 'pid'; choose from droop, droop-q"),
        (["tune", "--laws", ","], "laws: must name at least one law, got ','; choose from"),
        (["tune", "--scenarios", "ieee124"], "no scenario 'ieee124'; did you mean ieee123"),
        (["tune", "--scenarios", "toy6", "--episodes", "0"], "episodes: must be at least 1, got 0"),
        (["tune", "--scenarios", "toy6", "--workers", "0"], "workers: must be at least 1, got 0"),
        (["hindsight", "--scenarios", "toy6", "--workers", "-1"], "workers: must be at least 1, got -1"),
        (["hindsight", "--scenarios", " , "], "scenarios: must name at least one scenario, or all, got ' , '"),
        (["hindsight", "--scenarios", "toy6", "--episodes", "0"], "episodes: must be at least 1, got 0"),
        (["hindsight", "--scenarios", "toy6", "--split", "exam"], "split is 'exam'; choose one of"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(arguments, message, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "--out", str(tmp_path / "out")])
    _is_one_line(stopped, capsys, message)
    assert not (tmp_path / "out").exists()


OWN = """
from dcgrid_env import make_scenario

def make():
    return make_scenario("toy6", name="mine", source_voltage_pu=1.01, horizon=10)
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder with a scenario of the user's own."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    return tmp_path


@pytest.mark.slow
def test_what_tune_finds_for_ones_own_scenario_is_what_others_use(here, capsys):
    with pytest.raises(ValueError, match="find its own with `dcgrid tune") as raised:
        make_controller("droop-q-tuned", ScenarioSpec("own.py:make").make("test"))
    advised = str(raised.value).partition("`")[2].rstrip("`")
    assert advised == "dcgrid tune --laws droop-q --scenarios own.py:make"
    command = [*advised.split()[1:], "--episodes", "1", "--workers", "1"]
    main(command)
    entry = json.loads((here / "results" / "tuned.json").read_text())["laws"]["droop-q"]["mine"]
    own = ScenarioSpec("own.py:make").make("test")
    assert entry["scenario_hash"] == scenario_hash(own.replace(split="validation"))
    found = make_controller("droop-q-tuned", own)
    assert found.k_q_mvar_per_pu_s == entry["parameters"]["k_q_mvar_per_pu_s"]  # pyright: ignore
    capsys.readouterr()
    main(["run", "--scenario", "own.py:make", "--controllers", "droop-q-tuned", "--episodes", "1"])
    assert "droop-q-tuned: gains for mine from results/tuned.json" in capsys.readouterr().out
    # The same command has nothing to do, until the scenario is another.
    main(command)
    assert "nothing to do: all results are already in" in capsys.readouterr().out
    (here / "own.py").write_text(OWN.replace("1.01", "1.02"))
    main(command)
    assert "wrote results/tuned.json" in capsys.readouterr().out


def test_overrides_are_part_of_what_was_tuned(here, monkeypatch, capsys):
    searched = _searches(monkeypatch)
    arguments = ["tune", "--laws", "droop", "--scenario", "toy6", "--episodes", "1", "--workers", "1"]
    for more in (["--set", "horizon=9"], ["--set", "horizon=9"], ["--set", "horizon=8"], []):
        main([*arguments, *more])
    assert len(searched) == 3
    entry = json.loads((here / "results" / "tuned.json").read_text())["laws"]["droop"]["toy6"]
    assert set(entry) == {"parameters", "J", "trials", "command"}  # of the preset itself, as those that ship


def test_two_scenarios_of_one_name_are_refused(here, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["tune", "--laws", "droop", "--scenarios", "own.py:make,./own.py:make"])
    _is_one_line(stopped, capsys, "names must differ, got 'mine' for both own.py:make and ./own.py:make")
    assert not (here / "results").exists()


def test_hindsight_of_ones_own_scenario(here, capsys, monkeypatch):
    _solutions(monkeypatch)
    arguments = ["hindsight", "--scenario", "own.py:make", "--workers", "1", "--episodes", "2", "--set"]
    main([*arguments, "background.load_sigma=0.1"])
    content = json.loads((here / "results" / "hindsight" / "mine.json").read_text())
    scenario = ScenarioSpec("own.py:make", ("background.load_sigma=0.1",)).make("test")
    assert content["scenario_hash"] == scenario_hash(scenario)
    assert content["command"] == (
        "dcgrid hindsight --scenarios own.py:make --set background.load_sigma=0.1 --split test --episodes 2"
    )
    known = published(scenario, FOLDER)
    assert known is not None
    assert known.seeds.tolist() == [0, 1]
    assert published(scenario) is None
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "background.load_sigma=0.2"])
    _is_one_line(
        stopped,
        capsys,
        "belongs to a different scenario named mine; move the file, or choose another --out or another name",
    )
    main([*arguments, "background.load_sigma=0.2", "name=../[x]"])
    (path,) = (p for p in (here / "results" / "hindsight").iterdir() if p.name != "mine.json")
    assert "[x]" not in path.name
    assert json.loads(path.read_text())["scenario"] == "../[x]"


@pytest.mark.slow
def test_other_processes_rebuild_ones_own_scenario(here):
    for jobs in ("1", "2"):
        common = ["--scenario", "own.py:make", "--set", "horizon=8", "--episodes", "2", "--workers", jobs]
        main(["hindsight", *common, "--out", f"h{jobs}"])
        main(["tune", "--laws", "droop-q,constant-q", *common, "--out", f"t{jobs}.json"])
    for one, two in (("h1/mine.json", "h2/mine.json"), ("t1.json", "t2.json")):
        assert json.loads((here / one).read_text()) == json.loads((here / two).read_text())


def test_what_ships_stands_though_the_command_had_another_name(tmp_path, capsys):
    shipped = files("dcgrid_env.baselines.data") / "tuned.json"
    (tmp_path / "tuned.json").write_bytes(shipped.read_bytes())
    main(["tune", "--laws", "droop", "--scenarios", "toy6,robust", "--out", str(tmp_path / "tuned.json")])
    printed = " ".join(capsys.readouterr().out.split())
    assert "kept 2 of 2 results that are already in" in printed
    assert "nothing to do: all results are already in" in printed
    assert (tmp_path / "tuned.json").read_bytes() == shipped.read_bytes()
