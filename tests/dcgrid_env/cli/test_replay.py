"""dcgrid replay, and the file that a command opens with --open."""

import importlib.util
import json
import sys
import webbrowser

import pytest

from dcgrid_env.cli.main import main
from dcgrid_env.core.commands.opening import offer
from dcgrid_env.core.commands.terminal import plain_console
from dcgrid_env.core.suggestions import from_clone

drawn = pytest.mark.skipif(
    importlib.util.find_spec("plotly") is None, reason=f"plotly not installed; {from_clone('replay')}"
)


@pytest.fixture
def opened(monkeypatch):
    """Collect the addresses that a browser would open."""
    seen: list[str] = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "open", lambda uri: seen.append(uri) or True)
    return seen


def command(monkeypatch, *words):
    """Run a command as the shell does, which results.json takes down."""
    monkeypatch.setattr(sys, "argv", ["dcgrid", *words])
    main()


def refused(capsys, *words):
    with pytest.raises(SystemExit) as stopped:
        main(["replay", *words])
    assert stopped.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


@drawn
@pytest.mark.slow
def test_a_stored_run_is_replayed_exactly(tmp_path, monkeypatch, capsys, opened):
    monkeypatch.chdir(tmp_path)
    few = ("--scenario", "toy6", "--set", "horizon=6", "--episodes", "2", "--seed", "3")
    command(monkeypatch, "run", *few, "--controllers", "none, droop", "--open")
    printed = capsys.readouterr().out
    assert "open results/run/figure.png; `dcgrid replay results/run`" in printed
    assert opened == [(tmp_path / "results/run/figure.png").as_uri()]
    main(["replay", "results/run", "--open"])
    printed = capsys.readouterr().out
    assert "was" not in printed  # J is what was stored
    assert "seed 3" in (tmp_path / "results/run/replay.html").read_text(encoding="utf-8")
    assert opened[1:] == [(tmp_path / "results/run/replay.html").as_uri()]
    results = tmp_path / "results/run/results.json"
    stored = json.loads(results.read_text())
    stored["episodes"][0]["J"] += 1e-3
    results.write_text(json.dumps(stored))
    main(["replay", "results/run", "--out", "again.html"])
    assert "warning: none: J is" in capsys.readouterr().out
    stored["meta"]["scenario_hash"] = "0"
    results.write_text(json.dumps(stored))
    assert "scenario has changed since the run" in refused(capsys, "results/run")


@drawn
@pytest.mark.slow
def test_a_run_begun_from_python_is_replayed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["mine.py", "--fast"])  # whatever script it is begun by
    few = ["--scenario", "toy6", "--set", "horizon=4", "--episodes", "1", "--controllers", "none", "--out", "here"]
    main(["run", *few])
    assert json.loads((tmp_path / "here/results.json").read_text())["meta"]["command"] == f"dcgrid run {' '.join(few)}"
    main(["replay", "here"])
    assert (tmp_path / "here/replay.html").is_file()


def test_a_run_of_code_asks_for_trust(tmp_path, monkeypatch, capsys):
    ran = tmp_path / "ran"
    (tmp_path / "law.py").write_text(f"open({str(ran)!r}, 'w')\n")
    about = {"command": "dcgrid run --scenario toy6 --controllers law.py:Law", "scenario_hash": "0"}
    (tmp_path / "results.json").write_text(json.dumps({"meta": about, "episodes": []}))
    monkeypatch.chdir(tmp_path)
    assert "must not name code unless trusted, got 'law.py:Law'; add --trust" in refused(capsys, ".")
    assert not ran.exists()


def test_bad_input_is_one_line(tmp_path, monkeypatch, capsys):
    def stored(meta):
        (tmp_path / "results.json").write_text(json.dumps({"meta": meta, "episodes": []}))
        return refused(capsys, str(tmp_path))

    assert "run-folder: must be given, or --scenario, but not both" in refused(capsys)
    said = refused(capsys, str(tmp_path))
    assert "must be an output folder of dcgrid run with results.json" in said
    assert said.endswith("in Python call dcgrid_env.rendering.replay(recorder.series(0))")
    assert "must be a file of dcgrid run (KeyError: 'command')" in stored({})
    assert "must be a file of dcgrid run (TypeError: " in stored({"command": None, "scenario_hash": ""})
    assert "must be written by dcgrid run" in stored({"command": "dcgrid benchmark", "scenario_hash": ""})
    assert "cannot parse the command" in stored({"command": "dcgrid run --colour red", "scenario_hash": ""})
    for words, message in (
        (["--compare", "pid"], "no controller 'pid'"),
        (["--compare", ","], "compare: must name at least one controller"),
        (["--compare", "none,none,droop,inverters,droop-q,volt-var"], "replay 4 at most"),
        (["--set", "horizon=9000000", "--compare", "none"], "are too much for one page"),
        (["--gif", "a.gif", "--fps", "nan"], "fps: must be at least 0.1, got nan"),
        (["--gif", "a.gif", "--fps", "1e9"], "fps: must be at most 100, got 1e+09"),
        (["--out", str(tmp_path)], "out: must be a file, got the folder"),
        (["--out", f"{tmp_path}/results.json/a.html"], "out: must be in a folder that can be created, got "),
        (["--gif", "a.mp4"], "gif: must end in .gif, got"),
        (["--gif", "a.gif", "--out", "a.html"], "out: must not be combined with --gif or --mp4"),
        (["--seed", "-1"], "seed: must be at least 0, got -1"),
    ):
        assert message in refused(capsys, "--scenario", "toy6", *words)
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    assert "a replay is drawn by plotly; install it" in refused(capsys, "--scenario", "toy6")


@pytest.mark.skipif(importlib.util.find_spec("imageio") is None, reason=f"imageio not installed; {from_clone('video')}")
@pytest.mark.slow
def test_a_gif_in_one_command(tmp_path, capsys):
    main(["replay", "--scenario", "toy6", "--set", "horizon=2", "--compare", "none", "--gif", str(tmp_path / "a.gif")])
    assert (tmp_path / "a.gif").read_bytes().startswith(b"GIF89a")
    assert f"open {tmp_path / 'a.gif'}" in capsys.readouterr().out


def test_without_a_display_nothing_is_opened(tmp_path, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(webbrowser, "open", lambda uri: pytest.fail("opened"))
    offer(plain_console(), tmp_path / "page.html", opens=True)
    assert "could not open the file: no display" in capsys.readouterr().out
