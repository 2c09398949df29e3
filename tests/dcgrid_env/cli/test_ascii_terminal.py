"""A terminal that shows ASCII alone: commands work on it, and their files are UTF-8 all the same."""

import os
import subprocess
import sys

import pytest

COMMANDS = {
    "help": ["--help"],
    "list": ["list"],
    "run": ["run", "--scenario", "toy6", "--set", "horizon=4", "--episodes", "1", "--out", "out"],
    "check": ["check", "toy6", "--set", "horizon=4", "--episodes", "1", "--workers", "1"],
    "benchmark": ["benchmark", "--scenarios", "toy6", "--set", "horizon=4", "--episodes", "1", "--out", "out"],
    "no such file, refused": ["replay", "Süd →"],
}
TERMINALS = {
    "ascii": {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"},
    "c": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
}


@pytest.mark.parametrize("terminal", TERMINALS)
@pytest.mark.parametrize(
    "name",
    [
        "help",
        "list",
        "no such file, refused",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("run", "check", "benchmark")),
    ],
)
@pytest.mark.slow
def test_a_command_on_an_ascii_terminal(tmp_path, name, terminal):
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONIOENCODING", "PYTHONUTF8", "LC_ALL")}
    done = subprocess.run(
        [sys.executable, "-m", "dcgrid_env.cli", *COMMANDS[name]],
        cwd=tmp_path,
        capture_output=True,
        env=variables | TERMINALS[terminal],
    )
    assert b"codec" not in done.stderr + done.stdout
    assert b"Traceback" not in done.stderr
    assert done.returncode == (2 if "refused" in name else 0), done.stderr
    assert (done.stdout + done.stderr).isascii()
    for file in tmp_path.rglob("*"):
        if file.suffix in (".json", ".md", ".html", ".csv"):
            file.read_text(encoding="utf-8")
    if name == "benchmark":
        assert not (tmp_path / "out" / "results.md").read_bytes().isascii()
