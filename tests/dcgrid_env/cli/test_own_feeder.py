"""``dcgrid run --feeder``: controllers on the user's own feeder."""

import json
import shutil

import pytest

from dcgrid_env import load_feeder, make_scenario, scenario_hash
from dcgrid_env.cli.main import main
from helpers.looped import ieee33_with_ties

SHORT = ("--episodes", "1", "--controllers", "none")


@pytest.fixture
def folders(tmp_path, monkeypatch):
    load_feeder("ieee13-3ph").to_csv(tmp_path / "my-feeder")
    load_feeder("das69").to_csv(tmp_path / "balanced")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "400")
    return tmp_path


def run(*arguments):
    main(["run", "--out", "out", *SHORT, *arguments, *(() if "--set" in arguments else ("--set", "horizon=3"))])
    with open("out/results.json", encoding="utf-8") as file:
        return json.load(file)


@pytest.mark.slow
def test_a_folder_with_loops_runs_with_its_loadings(folders, capsys):
    feeder = ieee33_with_ties(2, rating_a=200.0)
    feeder.to_csv(folders / "looped")
    results = run("--feeder", "looped", "--controllers", "none,droop,mpc", "--set", "horizon=3")
    out = capsys.readouterr().out
    assert "balanced feeder ieee33, 33 buses" in out
    assert "error of LinDistFlow" not in out
    assert {record["controller"] for record in results["episodes"]} == {"none", "droop", "mpc"}
    for record in results["episodes"]:
        assert record["power_flow_converged"] == 1.0
        assert 50.0 < record["loading_max_pct"] < 200.0


@pytest.mark.parametrize(
    ("feeder", "said"),
    [
        ("my-feeder", "three-phase feeder ieee13-3ph, 16 buses, 3466 kW of load: 3 data centres of 460 kW drawn among"),
        ("balanced/", "balanced feeder das69, 69 buses, 3802 kW of load: 5 data centres of 300 kW drawn among"),
        ("ieee34-3ph", "drawn among 14 load buses of three phases; 7 inverters of 25 kVA at buses 802,"),
    ],
)
@pytest.mark.slow
def test_a_folder_or_a_name_runs_with_what_is_chosen(feeder, said, folders, capsys):
    run("--feeder", feeder)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "kW of load" in line]
    assert said in line
    assert line.endswith("use --set to change fields")


@pytest.mark.slow
def test_the_commands_of_the_document_and_the_file_that_runs_again(folders, capsys):
    given = ("n_datacenters=2", "datacenters.p_rated_kw=400", "grid_control.regulators=fixed", "horizon=3")
    results = run("--feeder", "my-feeder", "--set", *given)
    printed = capsys.readouterr().out
    assert "2 data centres of 400 kW drawn among 3 load buses of three phases" in printed
    assert "power flow sweep, regulators fixed" in printed
    again = make_scenario("out/scenario.toml", split="test")
    assert scenario_hash(again) == results["meta"]["scenario_hash"]
    main(["run", "--scenario", "out/scenario.toml", "--out", "more", *SHORT])
    assert json.loads((folders / "more" / "results.json").read_text())["episodes"] == results["episodes"]


@pytest.mark.slow
def test_a_feeder_takes_the_place_of_the_scenarios(folders, capsys):
    results = run("--scenario", "ieee33", "--feeder", "das69", "--set", "horizon=3")
    expected = make_scenario("ieee33", feeder="das69", horizon=3, split="test")
    assert results["meta"]["scenario_hash"] == scenario_hash(expected)
    assert "4 data centres of 600 kW at buses 18, 33, 25, 22" in capsys.readouterr().out
    # The power flow is that of the feeder's kind.
    run("--scenario", "ieee123", "--feeder", "ieee123-3ph")
    assert "power flow sweep" in capsys.readouterr().out


@pytest.mark.slow
def test_devices_in_words_are_placed_printed_and_written_as_a_file_for_all_commands(folders, capsys):
    load_feeder("das69").scaled(1.01, 1.0).to_csv("changed")
    words = ("--datacenters", "3 x 250 kW at ends", "--inverters", "2 x 200 kvar", "--save-scenario", "mine.toml")
    results = run("--feeder", "changed/", *words)
    printed = capsys.readouterr().out
    assert "3 data centres of 250 kW at buses 27, 65, 35; 2 inverters of 200 kVA at buses " in printed
    assert printed.splitlines()[1] == "source at 1 p.u., from changed/feeder.toml"
    assert "run `dcgrid check mine.toml` to see whether control can gain anything there\nopen out/figure.png" in printed
    assert not (folders / "out" / "scenario.toml").exists()
    mine = make_scenario("mine.toml", split="test")
    assert scenario_hash(mine) == results["meta"]["scenario_hash"]
    assert 'feeder = "changed"' in (folders / "mine.toml").read_text(encoding="utf-8")
    shown = printed[printed.index("name = ") : printed.index("on-das69, test")]
    (folders / "shown.toml").write_text(shown, encoding="utf-8")
    assert make_scenario("shown.toml", split="test").difference(mine) is None


@pytest.mark.slow
def test_tune_evaluate_benchmark_hindsight_and_training_take_the_file_as_a_preset(folders, capsys):
    pytest.importorskip("torch")
    load_feeder("das69").scaled(1.01, 1.0).to_csv("files/changed")
    run("--feeder", "files/changed", "--datacenters", "2 x 250 kW", "--save-scenario", "files/mine.toml")
    file, few = ("--scenario", "files/mine.toml"), ("--episodes", "2")
    main(["tune", "--laws", "droop-q", *file, "--episodes", "1", "--workers", "1"])
    tuned = json.loads((folders / "results/tuned.json").read_text())["laws"]
    tuned["droop"] = tuned["droop-q"]  # a search of three parameters takes longer and shows no more
    (folders / "results/tuned.json").write_text(json.dumps({"laws": tuned}))
    main(["evaluate", "droop-q-tuned", *file, *few, "--hindsight", "--workers", "1"])
    said = capsys.readouterr().out
    assert "droop-q-tuned: gains for on-das69 from results/tuned.json" in said
    assert "score" in said
    assert "no score" not in said
    short = ("--updates", "1", "--num-envs", "2", "--validation-episodes", "2", "--out", "trained")
    main(["train", "analytic", *file, *short])
    main(["evaluate", "trained", *few])  # the file is in the run's configuration
    assert "no score" not in capsys.readouterr().out
    main(["run", *file, "--controllers", "none,droop-tuned", "--episodes", "1", "--out", "again"])
    main(["benchmark", *file, "--controllers", "none", *few, "--workers", "1", "--out", "bench"])
    assert "no score" not in capsys.readouterr().out
    main(["hindsight", *file, *few, "--workers", "1"])
    assert "2 episodes, mean J" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--datacenters", "3 x 1 MW"], "datacenters: requires --feeder"),
        (["--save-scenario", "a.toml"], "save_scenario: requires --feeder"),
        (["--feeder", "balanced", "--save-scenario", "a.txt"], "save_scenario: must end in .toml, got 'a.txt'"),
        (["--feeder", "balanced", "--datacenters", "3 x 1 kvar"], "datacenters: '3 x 1 kvar' is in 'kvar'; give kW"),
        (
            ["--feeder", "balanced", "--inverters", "1 kvar at 700"],
            "inverters: feeder 'das69' has no bus '700'; it has",
        ),
        (
            ["--feeder", "das69", "--scenario", "ieee33", "--inverters", "none"],
            "inverters: must not be combined with --scenario ieee33, which defines the devices; remove one",
        ),
        (["--feeder", "no-folder"], "no feeder 'no-folder'; "),
        (["--feeder", "no-folder"], "or give a folder of your own"),
        (["--feeder", "."], "feeder .: feeder.toml is missing"),
        (["--feeder", ""], "feeder: must not be empty; give a feeder's name or folder"),
        (["--feeder", "broken"], "feeder broken: broken/loads.csv, line 2: "),
        (["--feeder", "my-feeder", "--set", "feeder=das69"], "set: must not contain feeder together with --feeder"),
        (["--feeder", "my-feeder", "--set", "power_flow=distflow"], "give 'sweep' for the three-phase feeder"),
        (["--feeder", "my-feeder", "--set", "n_datacenters=9"], "datacenters.count is 9; only 3 load buses"),
        (["--feeder", "my-feeder", "--set", "inverters.buses=[999]"], "feeder 'ieee13-3ph' has no bus '999'"),
        (
            ["--feeder", "my-feeder", "--set", "datacenters.clock_law=linear", "--dvfs", "linear"],
            "set: datacenters.clock_law is chosen by an option",
        ),
        (
            ["--feeder", "my-feeder", "--scenario", "ieee33"],
            "feeder 'ieee13-3ph' lacks buses 18, 33, 25, 22, where scenario 'ieee33' has devices (datacenters.buses); "
            "remove --scenario to choose devices for the feeder, or pass --set 'datacenters.buses=[..]'",
        ),
        (["--feeder", "ieee33", "--scenario", "ieee123"], "lacks buses 40, 54, 87, 92, 103, where scenario 'ieee123'"),
        (["--feeder", "ieee33", "--scenario", "ieee124"], "no scenario 'ieee124'"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(arguments, message, folders, capsys):
    shutil.copytree("my-feeder", "broken")
    table = folders / "broken" / "loads.csv"
    head, first, *rest = table.read_text().splitlines()
    table.write_text("\n".join([head, first.rpartition(",")[0] + ",xx", *rest]))
    with pytest.raises(SystemExit) as stopped:
        main(["run", "--out", "out", *SHORT, *arguments])
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("dcgrid: ")
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert not (folders / "out").exists()
