"""What is left behind by a command that an error, Ctrl-C or a termination ends: nothing that is half done."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from dcgrid_env.baselines.tuning.search import Tuned
from dcgrid_env.cli.main import main
from dcgrid_env.core.lock import locked

SHORT = ("--episodes", "1", "--workers", "1")
WRITING = {
    "run": (("run", "--scenario", "toy6", "--episodes", "1", "--out", "out"), "results.json"),
    "run, its figure": (("run", "--scenario", "toy6", "--episodes", "1", "--out", "out"), "figure.png"),
    "benchmark": (("benchmark", "--scenarios", "toy6", "--controllers", "none", *SHORT, "--out", "out"), "about.json"),
    "hindsight": (("hindsight", "--scenarios", "toy6", *SHORT, "--out", "out/deep"), "toy6.json"),
    "tune": (
        ("tune", "--scenarios", "toy6", "--laws", "droop-q", *SHORT, "--out", "out/tuned.json"),
        "tuned.json",
    ),
    "reproduce": (("reproduce", "--trace", "generated", "--out", "out"), "reproduction.json"),
    "dataset": (("dataset", "--scenario", "toy6", "--episodes", "1", "--out", "out"), "card.json"),
    "dataset, whole": (("dataset", "--scenario", "toy6", "--episodes", "1", "--out", "out"), "droop-tuned-v0"),
    "traces show": (("traces", "show", "training", "--duration-s", "10", "--out", "out/trace.png"), "trace.png"),
    "train": (("train", "analytic", "--scenario", "toy6", "--num-envs", "4", "--out", "out"), "config.json"),
}
KEPT = {"run, its figure": {"results.json"}}
"""Whole files that were in place before."""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Change to a temporary working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def quick(monkeypatch):
    """Replace slow functions; the commands still write the files."""
    solved = SimpleNamespace(J=1.0, bound=1.0, rounds=1)
    monkeypatch.setattr("dcgrid_env.baselines.model_based.hindsight.hindsight", lambda scenario, seed: solved)
    tuned = Tuned(parameters={}, score=1.0, trials=1)
    monkeypatch.setattr("dcgrid_env.baselines.tuning.search.tune", lambda law, scenarios, episodes: tuned)
    monkeypatch.setattr("dcgrid_env.apps.reproduction.study.study", lambda runs, done, place: {"claims": []})
    monkeypatch.setattr("dcgrid_env.apps.reproduction.markdown.render", lambda records: "")


def signalled(monkeypatch, sign, file):
    """Let a signal come when that file has been written and is not in place yet."""
    replace = Path.replace

    def interrupted(self, target):
        if Path(target).name == file:
            signal.raise_signal(sign)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", interrupted)


def names(folder):
    return {path.name for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("name", "sign", "status"),
    [*((name, signal.SIGINT, 130) for name in WRITING), *((name, signal.SIGTERM, 143) for name in ("run", "train"))],
)
def test_a_signal_while_a_file_is_written_leaves_nothing(here, quick, monkeypatch, name, sign, status):
    arguments, file = WRITING[name]
    signalled(monkeypatch, sign, file)
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    assert ended.value.code == status
    assert names(here) == KEPT.get(name, set())
    assert (here / "out").exists() == (name in KEPT)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@pytest.mark.slow
def test_an_interrupted_training_keeps_what_is_whole_and_no_half_of_a_checkpoint(here, monkeypatch, capsys):
    arguments = [*WRITING["train"][0], "--validate-every", "1", "--checkpoint-every", "1", "--validation-episodes", "2"]
    signalled(monkeypatch, signal.SIGINT, "checkpoint.pt")
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 130
    assert capsys.readouterr().err == "dcgrid: interrupted; run the same command with --resume to continue\n"
    kept = {name for name in names(here) if not name.startswith("events.out")}
    assert kept == {"config.json", "curve.csv", "policy.json", "policy.safetensors"}


@pytest.mark.slow
def test_interrupted_trainings_in_processes_of_their_own_leave_nothing_half_done(here):
    """Ctrl-C ends them by a termination, whatever they are doing."""
    arguments = ["train", "analytic", "--scenario", "toy6", "--seeds", "2", "--updates", "100000", "--workers", "2"]
    command = [sys.executable, "-m", "dcgrid_env.cli.main", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    began = time.monotonic()
    while len(list(here.rglob("config.json"))) < 2:
        assert process.poll() is None
        assert time.monotonic() - began < 300
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert (process.returncode, said) == (130, "dcgrid: interrupted; run the same command again to resume\n")
    assert not [name for name in names(here) if name.startswith(".")]


@pytest.mark.parametrize(
    ("arguments", "out"),
    [
        (("train", "ppo", "--scenario", "toy6", "--steps", "0"), "results"),
        (("train", "safe", "--scenario", "toy6", "--margin", "2"), "results"),
        (("reproduce", "--trace", "no-such"), "results"),
        (("traces", "show", "training", "--duration-s", "10", "--out", "new/trace.xyz"), "new"),
        (("traces", "fetch", "no-such", "--cache", "new"), "new"),
        (("tune", "--laws", "none", "--out", "new/tuned.json"), "new"),
        (("hindsight", "--split", "exam", "--out", "new"), "new"),
    ],
)
def test_a_command_that_fails_at_once_makes_no_folder(here, arguments, out):
    with pytest.raises(SystemExit) as stopped:
        main(list(arguments))
    assert stopped.value.code == 2
    assert not (here / out).exists()


@pytest.mark.parametrize("name", ["benchmark", "hindsight", "tune"])
@pytest.mark.slow
def test_a_second_command_that_changes_the_same_files_is_one_line(here, capsys, quick, name):
    words, _ = WRITING[name]
    folder = here / ("out/deep" if name == "hindsight" else "out")
    folder.mkdir(parents=True)
    with locked(folder, "dcgrid test"), pytest.raises(SystemExit) as stopped:
        main([*words])
    said = capsys.readouterr().err
    assert stopped.value.code == 2
    assert f"another dcgrid test (process {os.getpid()} on " in said
    assert said.endswith("writes there; wait until it has ended, or use another folder\n")
    assert len(said.splitlines()) == 1
    assert not list(folder.iterdir())
    main([*words])  # free again


def test_a_second_training_in_the_folder_is_one_line(here, capsys):
    with locked(here, "training"), pytest.raises(SystemExit) as stopped:
        main(["train", "analytic", "--scenario", "toy6", "--out", str(here)])
    said = capsys.readouterr().err
    assert stopped.value.code == 2
    assert said.startswith(f"dcgrid: {here}: another training (process {os.getpid()} on ")
    assert len(said.splitlines()) == 1
