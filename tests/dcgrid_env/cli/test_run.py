"""The command line, as a user runs it."""

import json
import math
import os
import sys

import pytest

import dcgrid_env
from dcgrid_env import PRESETS, make_scenario, scenario_hash
from dcgrid_env.baselines import CONTROLLERS, Droop
from dcgrid_env.cli.main import main
from dcgrid_env.cli.run import Run, controller_names, scenario_of
from helpers.forms import each_preset


def run(tmp_path, *arguments):
    main(["run", "--out", str(tmp_path), *arguments])
    return json.loads((tmp_path / "results.json").read_text())


@pytest.mark.parametrize("scenario", each_preset(("toy6", "ieee34-3ph", "routing", "zero-shot")))
@pytest.mark.slow
def test_run_writes_a_table_a_figure_and_records(scenario, tmp_path, capsys):
    results = run(tmp_path, "--scenario", scenario, "--episodes", "2", "--seed", "3", "--controllers", "none, droop")
    printed = capsys.readouterr().out
    assert "mean |V-1|" in printed
    assert "2 episodes" in printed
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert results["meta"]["versions"]["numpy"]
    assert results["meta"]["machine"]["cores"] >= 1
    keys = [(r["scenario"], r["controller"], r["episode"], r["seed"]) for r in results["episodes"]]
    assert keys == [(scenario, c, i, 3 + i) for c in ("none", "droop") for i in range(2)]
    for record in results["episodes"]:
        numbers = {k: v for k, v in record.items() if k not in ("scenario", "controller")}
        assert all(math.isfinite(v) for v in numbers.values())
        assert record["J"] == pytest.approx(sum(v for k, v in record.items() if k.startswith("cost_")))
    assert not list(tmp_path.glob("*.part"))


def test_the_default_controllers_use_a_storage():
    scenario = make_scenario("ieee33-weak-ups", split="test")
    assert controller_names(Run(), scenario) == ["none", "droop", "analytic"]
    assert controller_names(Run(), scenario.replace(name="my-storages")) == ["none", "droop", "peak-shaving"]
    assert controller_names(Run(), make_scenario("toy6").replace(name="my-feeder")) == ["none", "droop", "inverters"]


def short_log(path, seconds):
    """A log of nvidia-smi with steps of 100 W, from 14:00 on."""
    rows = (
        f"2026/03/01 14:{s // 60:02d}:{s % 60:02d}.000, 0, {300 + 100 * (s // 30 % 2)}.00 W" for s in range(seconds)
    )
    path.write_text("timestamp, index, power.draw [W]\n" + "\n".join(rows) + "\n")
    return str(path)


@pytest.mark.slow
def test_ten_minutes_of_a_log_do_for_run_and_check(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    log = short_log(tmp_path / "smi.csv", 600)
    ask = ("--scenario", "ieee33-weak", "--trace", log, "--controllers", "none", "--episodes", "2")
    assert run(tmp_path / "a", *ask)["meta"]["split"] == "whole"
    printed = capsys.readouterr().out
    assert "episodes lie in the whole of trace smi, 599 s" in printed
    assert "is repeated" not in printed
    run(tmp_path / "b", *ask, "--horizon", "700", "--set", "cost.ramp_limit_kw_per_s=1e6")
    assert "trace smi: lasts 599 s and episodes need 702 s, so it is repeated" in capsys.readouterr().out
    main(["check", "ieee33-weak", "--set", f"trace={log}", "--episodes", "1", "--seconds", "1", "--workers", "1"])
    assert "episodes lie in the whole of trace smi" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        run(tmp_path / "c", *ask, "--split", "test")
    assert (
        "the split 'whole', which dcgrid run, check, capacity and study use by default, has all of it"
        in capsys.readouterr().err
    )


@pytest.mark.slow
def test_load_profiles_of_a_day_do_on_a_feeder_and_are_saved_for_training(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    loads = "".join(f"{hour},{0.5 + 0.4 * (hour == 18)}\n" for hour in range(24))
    (tmp_path / "day.csv").write_text("time_h,home\n" + loads)
    (tmp_path / "classes.csv").write_text("load,class\n" + "".join(f"{bus},home\n" for bus in range(2, 34)))
    profiles = f'load_profiles={{file="{tmp_path}/day.csv",columns="class",classes="{tmp_path}/classes.csv"}}'
    found = run(
        tmp_path / "a", "--feeder", "ieee33", "--set", profiles, "--controllers", "none", "--episodes", "2",
        "--horizon", "20",
    )  # fmt: skip
    assert found["meta"]["split"] == "whole"
    assert "day.csv, 24 h" in capsys.readouterr().out
    assert make_scenario(str(tmp_path / "a/scenario.toml")).load_profiles.days == "split"


def test_presets_keep_the_split_test():
    assert scenario_of(Run(scenario="ieee33-weak")).split == "test"


@pytest.mark.slow
def test_the_same_command_gives_the_same_records(tmp_path):
    first = run(tmp_path / "a", "--episodes", "1", "--controllers", "droop")
    again = run(tmp_path / "b", "--episodes", "1", "--controllers", "droop")
    assert first["episodes"] == again["episodes"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scenario", "ieee124"], "no scenario 'ieee124'; did you mean ieee123"),
        (["--controllers", "none,pid"], "no controller 'pid'; "),
        (["--controllers", " , "], "must name at least one"),
        (["--episodes", "0"], "episodes: must be at least 1, got 0"),
        (["--split", "exam"], "split is 'exam'; choose one of train, validation, test"),
        (["--set", "horizn=3"], "horizn"),
        (["--set", "horizon"], "set: 'horizon' is no field with its value"),
        (["--set", "horizon=0"], "horizon is 0; give a whole number of at least 1"),
        (
            ["--set", "datacenters.clock_law=prefill-decode", "--dvfs", "linear"],
            "set: datacenters.clock_law is chosen by an option of the command; leave one of them out",
        ),
        (
            ["--controllers", "droop-tuned", "--set", "source_voltage_pu=1.0"],
            "differs in source_voltage_pu; find its own with `dcgrid tune",
        ),
        (["--controllers", "droop-tuned", "--tuned", "none.json"], "tuned is 'none.json', which is no file"),
        (["--controllers", "own.py:Law(", "--scenario", "toy6"], "names: brackets must be closed, got 'own.py:Law('"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(arguments, message, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        run(tmp_path / "out", *arguments)
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("dcgrid: ")
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_an_output_folder_that_cannot_be_made_is_found_before_anything_runs(tmp_path, capsys):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(SystemExit) as stopped:
        run(tmp_path / "out", "--scenario", "toy6")
    assert stopped.value.code == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("dcgrid: out: must be a folder that can be created, got ")
    assert printed.out == ""


@pytest.mark.parametrize("where", ["__init__(self)", "reset(self, env_info)", "act(self, observations)"])
def test_a_controller_that_ends_the_program_does_not_end_it_as_if_all_were_well(where, tmp_path, capsys):
    own = tmp_path / "own.py"
    law = "class Exit:\n    def reset(self, env_info): ...\n    def act(self, observations): ...\n"
    own.write_text(f"import sys\n{law}    def {where}:\n        sys.exit()\n")
    with pytest.raises(SystemExit) as stopped:
        run(tmp_path / "out", "--episodes", "1", "--scenario", "toy6", "--controllers", f"none,{own}:Exit")
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith(f"dcgrid: controller '{own}:Exit'")
    assert "SystemExit" in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_list_shows_everything(capsys):
    main(["list"])
    printed = capsys.readouterr().out
    for name in (*PRESETS, *CONTROLLERS, "khodr141", "inference", "training", "dcgrid/IEEE123-v0"):
        assert name in printed


@pytest.mark.slow
def test_gains_beyond_the_bound_are_told(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.setitem(CONTROLLERS, "steep", ("too steep", lambda: Droop(k_p_mw_per_pu=20.0)))
    run(tmp_path, "--scenario", "ieee123", "--episodes", "1", "--controllers", "droop,steep")
    printed = capsys.readouterr().out
    assert "steep: droop's gains are beyond the linear stability bound on ieee123" in printed
    assert "\ndroop: " not in printed


OWN = """
import numpy as np
from dcgrid_env import make_scenario

print("imported")

def make():
    return make_scenario("toy6", name="[/]", horizon=10)

class Law:
    def __init__(self, q=0.0, mode="none"):
        print("made with", q, mode)
        self.q = q

    def reset(self, env_info):
        self.n = env_info.datacenters.count * 2 + env_info.inverters.count

    def act(self, observations):
        return np.full((len(observations), self.n), self.q)

class Fails(Law):
    def act(self, observations):
        return {}["k"]
"""


@pytest.mark.slow
def test_ones_own_scenario_with_overrides_and_arguments(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    out = tmp_path / "[/]"
    specs = "own.py:Law(q=0.5, mode=fast),own.py:Law(0.25),none"
    results = run(
        out, "--scenario", "own.py:make", "--set", "horizon=7", "background.load_sigma=0.1", "--controllers", specs
    )
    printed = capsys.readouterr().out
    assert printed.count("imported") == 1
    assert "made with 0.5 fast" in printed
    assert "made with 0.25 none" in printed
    assert "[/], test split, 8 episodes of 7 s" in printed
    assert list(dict.fromkeys(r["controller"] for r in results["episodes"])) == [
        "own.py:Law(q=0.5, mode=fast)", "own.py:Law(0.25)", "none",
    ]  # fmt: skip
    expected = make_scenario("toy6", name="[/]", horizon=7, background={"load_sigma": 0.1}, split="test")
    assert results["meta"]["scenario_hash"] == scenario_hash(expected)
    assert "'own.py:Law(q=0.5, mode=fast),own.py:Law(0.25),none'" in results["meta"]["command"] or "[" in str(out)


@pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
def test_a_termination_while_a_controller_acts_is_no_failure_of_the_controller(tmp_path, capsys):
    own = tmp_path / "own.py"
    terminated = "import signal; signal.raise_signal(signal.SIGTERM)"
    own.write_text(OWN.replace('return {}["k"]', terminated))
    with pytest.raises(SystemExit) as stopped:
        run(tmp_path / "out", "--scenario", "toy6", "--controllers", f"{own}:Fails", "--episodes", "1")
    assert stopped.value.code == 143
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("where", [0, 1, 3])
def test_a_controller_that_fails_is_one_line_and_whole_where_that_is_asked_for(where, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN.replace('print("imported")', ""))
    arguments = ["run", "--scenario", "toy6", "--controllers", "own.py:Fails", "--episodes", "1"]
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error == (
        "dcgrid: controller 'own.py:Fails' fails in act, own.py line 23: KeyError: 'k'; "
        "add --traceback for the full traceback\n"
    )
    with pytest.raises(SystemExit) as stopped:
        main([*arguments[:where], "--traceback", *arguments[where:]])
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert 'return {}["k"]' in error
    assert "Traceback (most recent call last):" in error
    assert not (tmp_path / "results").exists()


@pytest.mark.slow
def test_a_run_too_long_to_be_kept_sums_up_and_writes_its_course(tmp_path, monkeypatch, capsys):
    parquet = pytest.importorskip("pyarrow.parquet")
    options = ("--scenario", "toy6", "--horizon", "60", "--episodes", "2", "--controllers", "none,droop")
    kept = run(tmp_path / "kept", *options)
    assert "metrics are computed while streaming" not in capsys.readouterr().out
    assert not (tmp_path / "kept" / "course").exists()
    monkeypatch.setattr(dcgrid_env, "WHOLE_COURSE_BYTES", 0)
    parts = run(tmp_path / "parts", *options)
    said = capsys.readouterr().out
    assert "2 x 60 steps need" in said
    assert f"trajectories are written to {tmp_path / 'parts' / 'course'}" in said
    for one, other in zip(kept["episodes"], parts["episodes"], strict=True):
        assert other == pytest.approx(one)
    for name in ("none", "droop"):
        assert parquet.read_table(tmp_path / "parts" / "course" / name).num_rows == 2 * 60
    assert (tmp_path / "parts" / "figure.png").read_bytes().startswith(b"\x89PNG")
    run(tmp_path / "none", *options, "--course", "none")
    assert "trajectories are not written" in capsys.readouterr().out
    assert not (tmp_path / "none" / "course").exists()


@pytest.mark.slow
def test_the_course_of_a_short_run_is_written_on_request(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    results = run(tmp_path, "--scenario", "toy6", "--episodes", "1", "--controllers", "none", "--course", "parquet")
    cost_j = parquet.read_table(tmp_path / "course" / "none")["cost_j"].to_numpy()
    assert cost_j.sum() / 100 == pytest.approx(results["episodes"][0]["J"])


def test_a_long_run_without_pyarrow_is_one_line_before_anything_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(SystemExit):
        run(tmp_path / "out", "--scenario", "toy6", "--controllers", "none", "--course", "parquet")
    (line,) = capsys.readouterr().err.splitlines()
    hint = "which is missing; in a clone of the repository: pip install -e '.[parquet]', or add --course none"
    assert line.endswith(hint)
    assert not (tmp_path / "out").exists()


def test_a_horizon_given_twice_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        run(tmp_path / "out", "--scenario", "toy6", "--horizon", "5", "--set", "horizon=6")
    assert "horizon: must be set once, got --horizon 5 and --set horizon" in capsys.readouterr().err
