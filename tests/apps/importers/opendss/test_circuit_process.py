"""The child process that reads a circuit: it ends with one error if OpenDSS crashes or hangs."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from dcgrid_env import FeederError
from dcgrid_env.apps.importers.opendss import circuit_process, read_opendss
from dcgrid_env.apps.importers.opendss.reading import read_circuit

pytest.importorskip("opendssdirect", reason="OpenDSSDirect.py is not installed (extra opendss)")
ENDLESS = "Set maxiterations=2000000000 tolerance=-1\nSolve"
MEMORY = "New Transformer.t windings=90 phases=90"
REPORTED = "New ISource.i bus1=n amps=1\nNew Capacitor.c bus1=n kv=12.47 kvar=90"


@pytest.mark.slow
def test_tables_findings_and_voltages_are_those_of_this_process(master):
    path = master(REPORTED)
    assert repr(read_opendss(path, allow=["isource"])) == repr(read_circuit(path, allow=["isource"]))
    with pytest.raises(FeederError, match="would be lost: isource i") as refused:
        read_opendss(path)
    with pytest.raises(FeederError) as here:
        read_circuit(path)
    assert str(refused.value) == str(here.value)


@pytest.mark.slow
def test_a_crash_is_one_line_that_names_the_file(master):
    how = r"Master\.dss: the process that reads it (crashed with SIG|ended with exit code)"
    with pytest.raises(FeederError, match=how) as crashed:
        read_opendss(master("New Transformer.t windings=100000"), trust=True)
    assert "\n" not in str(crashed.value)


@pytest.mark.skipif(sys.platform != "linux", reason="the operating system does not limit the address space")
@pytest.mark.slow
def test_memory_is_limited(master):
    path = master(MEMORY)
    with pytest.raises(FeederError, match=r"Master.dss"):
        read_opendss(path)


@pytest.fixture
def children(monkeypatch):
    """The processes that are started."""
    started = []

    class Popen(subprocess.Popen):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Popen)
    return started


@pytest.mark.slow
def test_time_is_limited(master, children, monkeypatch):
    monkeypatch.setattr(circuit_process, "LONGEST_S", 3.0)
    with pytest.raises(FeederError, match=r"Master.dss: reading it took more than 3 s; if you trust .* --trust"):
        read_opendss(master(ENDLESS))
    assert children[0].returncode


@pytest.mark.skipif(sys.platform == "win32", reason="a signal that Windows does not have")
@pytest.mark.slow
def test_an_interrupt_ends_the_child(master, children):
    threading.Timer(3.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        read_opendss(master(ENDLESS))
    assert children[0].returncode == -signal.SIGKILL


@pytest.mark.skipif(sys.platform == "win32", reason="a parent's end is not seen on Windows")
@pytest.mark.slow
def test_the_child_ends_with_a_parent_that_is_killed(master):
    script = (
        "import subprocess, sys\nstart = subprocess.Popen.__init__\n"
        "def told(self, *a, **k):\n    start(self, *a, **k)\n    print(self.pid, flush=True)\n"
        "subprocess.Popen.__init__ = told\n"
        "from dcgrid_env.apps.importers.opendss import read_opendss\nread_opendss(sys.argv[1])"
    )
    with subprocess.Popen([sys.executable, "-c", script, str(master(ENDLESS))], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        time.sleep(3.0)  # it is at its endless work
        os.kill(child, 0)
        parent.kill()
    for _ in range(100):
        try:
            os.kill(child, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    raise AssertionError("the child outlives its parent")
