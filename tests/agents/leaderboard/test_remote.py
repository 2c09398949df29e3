"""Processes of controllers: how they start, fail and end."""

import os
import re
import subprocess
import sys

import pytest

from dcgrid_env.agents.leaderboard import remote
from dcgrid_env.agents.leaderboard.remote import ControllerProcess, ProcessError
from dcgrid_env.cli.main import main
from helpers.submitted_code import acted, confines

ON_WINDOWS = """
import sys
missing = ("resource", "fcntl", "termios", "pwd", "grp")
for name in missing:
    sys.modules[name] = None
import os
for name in ("O_ACCMODE", "killpg", "fork", "pread", "waitid", "SCHED_IDLE"):
    delattr(os, name)
import dcgrid_env.agents.leaderboard.verifying
import dcgrid_env.agents.leaderboard.controller_process
"""
CONFINING = """
import ctypes, pathlib, resource, sys
from dcgrid_env.agents.leaderboard import confinement, system_calls

def fails(*_):
    raise ValueError("not allowed to raise maximum limit")

class Libc:
    "The C library, in which calls fail."
    def __getattr__(self, name):
        return lambda *arguments: self.call(name, arguments)

    def call(self, name, arguments):
        if name == "{call}" and arguments[: len({start})] == {start}:
            ctypes.set_errno(1)
            return -1
        return getattr(real, name)(*arguments)

real = confinement._libc()
confinement._libc = Libc
if "{call}" == "setrlimit":
    resource.setrlimit = fails
try:
    confinement.confine(pathlib.Path(sys.argv[1]))
except confinement.ConfinementError as error:
    print(error)
"""
WITHOUT_SECCOMP = """
import ctypes, struct
from helpers.submitted_code import acted

filters = [
    (0x20, 0, 0, 0), (0x15, 0, 3, 157), (0x20, 0, 0, 16), (0x15, 0, 1, 22),  # prctl(PR_SET_SECCOMP)
    (0x06, 0, 0, 0x50000 | 22), (0x06, 0, 0, 0x7FFF0000),  # EINVAL, as of a kernel without it; all else is allowed
]
program = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *one) for one in filters))
described = ctypes.create_string_buffer(struct.pack("HxxxxxxP", len(filters), ctypes.addressof(program)))
libc = ctypes.CDLL(None)
assert libc.prctl(38, 1, 0, 0, 0) == libc.prctl(22, 2, described, 0, 0) == 0
try:
    acted("open('ran', 'w')", confined=True)
except ValueError as error:
    print(error)
"""


@pytest.mark.slow
def test_the_modules_are_imported_without_the_modules_of_unix():
    subprocess.run([sys.executable, "-c", ON_WINDOWS], check=True)


@pytest.mark.parametrize("arguments", [["verify", "entry"], ["submit", "constant-q-tuned", "--name", "x"]])
def test_entries_need_linux(arguments, monkeypatch, capsys, tmp_path):
    (tmp_path / "entry").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(remote.sys, "platform", "win32")
    with pytest.raises(SystemExit):
        main(arguments)
    assert "need Linux" in capsys.readouterr().err


@confines
@pytest.mark.parametrize(
    ("call", "start", "message"),
    [
        ("setrlimit", (), r"resource limit RLIMIT_AS of \d+ fails: not allowed to raise maximum limit"),
        ("syscall", (445,), "Landlock: allow .* fails: Operation not permitted"),
        ("syscall", (446,), "Landlock: apply rules fails: Operation not permitted"),
        ("capset", (), "drop capabilities fails: Operation not permitted"),
        ("prctl", (38,), "no new privileges fails: Operation not permitted"),
        ("prctl", (22,), "seccomp: filter system calls fails: Operation not permitted"),
    ],
)
@pytest.mark.slow
def test_a_part_of_the_confinement_that_fails_is_named(call, start, message, tmp_path):
    program = CONFINING.format(call=call, start=start)
    command, one_thread = [sys.executable, "-c", program, tmp_path], remote._environment(str(tmp_path))
    ended = subprocess.run(command, env=one_thread, capture_output=True, text=True, check=True)
    assert ended.stdout.count("\n") == 1
    assert re.fullmatch(message, ended.stdout.strip()), ended.stdout


@confines
@pytest.mark.slow
def test_code_does_not_run_on_a_kernel_without_seccomp():
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(remote.import_path())}
    command = [sys.executable, "-c", WITHOUT_SECCOMP]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert re.fullmatch(
        r"controller 'controller.py:Own' fails in loading: .*seccomp: filter system calls fails: Invalid argument.*\n",
        ended.stdout,
    )


@confines
@pytest.mark.parametrize("confined", [False, True])
@pytest.mark.slow
def test_a_process_imports_what_this_one_can(confined, tmp_path, monkeypatch):
    (tmp_path / "elsewhere.py").write_text("figure = 7.0")
    monkeypatch.syspath_prepend(tmp_path)
    body = "import elsewhere\nreturn np.full((len(observations), 4), elsewhere.figure)"
    assert (acted(body, confined=confined) == 7.0).all()


@confines
@pytest.mark.slow
def test_confined_code_cannot_read_the_folders_of_the_script_and_of_the_work(tmp_path, monkeypatch):
    for name in ("script", "work"):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"of_{name}.py").touch()
        monkeypatch.syspath_prepend(tmp_path / name)
    monkeypatch.setattr(sys, "argv", [str(tmp_path / "script" / "of_script.py")])
    monkeypatch.chdir(tmp_path / "work")
    for name in ("script", "work"):
        with pytest.raises(ProcessError, match=f"No module named 'of_{name}'"):
            acted(f"import of_{name}")
        with pytest.raises(ProcessError, match="PermissionError"):
            acted(f"os.listdir({str(tmp_path / name)!r})", confined=True)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "work"))
    assert acted("import of_work", confined=True).shape == (2, 4)


@pytest.mark.slow
def test_the_last_line_of_standard_error_is_reported():
    body = (
        "sys.stderr.write('first\\n' * 10_000 + 'library X\\x1b[2J\\tis missing\\n')\nsys.stderr.flush()\nos._exit(4)"
    )
    with pytest.raises(ProcessError, match=r"its process ended \(exit status 4: library X \[2J is missing\)"):
        acted(body)


def test_a_number_of_a_process_that_was_waited_for_is_not_signalled(monkeypatch):
    process = ControllerProcess()
    process._process.kill()
    process._process.wait()
    signalled = []
    monkeypatch.setattr(os, "killpg", lambda *arguments: signalled.append(arguments))
    assert not process.runs
    process.close()
    process.close()
    assert signalled == []
