"""Ctrl-C while modules load ends a command, whatever swallows the exception on its way."""

import os
import signal
import subprocess
import sys
import time

import pytest

from dcgrid_env.core.signals import raising

SWALLOWED = """
import signal, sys
class Swallowing:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            print("asked for", file=sys.stderr)
            try:
                signal.raise_signal(signal.SIGINT)
            except BaseException:
                pass
sys.meta_path.insert(0, Swallowing())
sys.argv = ["dcgrid", *{words!r}]
from dcgrid_command import main
main()
"""
COMMANDS = {
    "list": ["list"],
    "run": ["run", "--scenario", "toy6", "--episodes", "1", "--out", "out"],
    "train": ["train", "analytic", "--scenario", "toy6", "--num-envs", "4", "--updates", "1", "--out", "out"],
}


@pytest.mark.parametrize(
    ("name", "module"),
    [
        ("list", "dcgrid_env"),
        ("list", "gymnasium"),
        ("list", "dcgrid_env.cli.main"),
        ("list", "dcgrid_env.traces.recordings"),
        ("run", "numba"),
        ("run", "matplotlib.figure"),
        ("train", "torch"),
    ],
)
@pytest.mark.slow
def test_an_interruption_that_a_library_swallows_ends_the_command(tmp_path, name, module):
    code = SWALLOWED.format(module=module, words=COMMANDS[name])
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    _, asked, said = done.stderr.partition("asked for\n")
    assert (done.returncode, bool(asked), len(said.splitlines())) == (130, True, 1), done.stderr
    assert said.startswith("dcgrid: interrupted")
    assert not (tmp_path / "out" / "results.json").exists()


def test_a_module_that_never_ends_loading_is_interrupted(tmp_path, monkeypatch):
    monkeypatch.setattr("dcgrid_env.core.signals.LONGEST_S", 0.1)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "never_loaded.py").write_text(
        "import signal, time\nsignal.raise_signal(signal.SIGINT)\ntime.sleep(60)\n"
    )
    began, before = time.monotonic(), signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), raising(signal.SIGINT, KeyboardInterrupt):
        __import__("never_loaded")
    assert time.monotonic() - began < 30
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.slow
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_while_kernels_compile_ends_the_command(tmp_path, number, status):
    words = ["run", "--scenario", "ieee34-3ph", "--out", "out"]
    code = f"import sys; sys.argv = ['dcgrid', *{words!r}]; from dcgrid_command import main; main()"
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=tmp_path, env=env, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stderr is not None
        for line in run.stderr:
            if "compiling kernels" in line:
                time.sleep(1.0)
                run.send_signal(number)
                break
        run.communicate(timeout=60)
    assert run.returncode == status
    assert not (tmp_path / "out" / "results.json").exists()


def test_a_signal_that_the_shell_has_ignored_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with raising(signal.SIGINT, KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
