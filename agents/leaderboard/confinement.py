"""Confinement of a process that runs code of a submitter: Landlock and seccomp of Linux, no capabilities, and limits.

The process can read Python, its packages and one empty folder, and write only to that folder. It cannot open the
files of the verifier, its memory (``/proc``, ptrace) or its key, send it signals, start programs, open sockets, lock
files or change their metadata. Decision 0029 lists the channels that remain.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from dcgrid_env.agents.leaderboard.system_calls import filter_system_calls, is_supported

MEMORY_BYTES = 8 * 2**30
"""Largest address space; torch alone reserves some GB."""
CPU_S = 3600
"""Most processor time."""
FILE_BYTES = 2**28
"""Largest file in its own folder."""
_CREATE, _ADD, _RESTRICT = 444, 445, 446
"""Numbers of Landlock's system calls, the same on all processors."""
_VERSION_FLAG, _BENEATH = 1, 1
_NO_NEW_PRIVILEGES, _CAPABILITY_VERSION = 38, 0x20080522
_READ = 1 << 2 | 1 << 3
"""Rights to read files and to list folders."""
_FILES = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 5: (1 << 16) - 1}
"""All rights over files that Landlock handles, from each version of its interface on."""
_OF_A_FILE = 1 << 0 | 1 << 1 | 1 << 2 | 1 << 14 | 1 << 15
"""Rights that a rule about a file, not a folder, may give."""


class ConfinementError(RuntimeError):
    """A system that cannot confine a process."""


def version() -> int:
    """Version of Landlock's interface; 0 where a process cannot be confined."""
    if sys.platform != "linux" or not is_supported():
        return 0
    return max(_libc().syscall(_CREATE, None, ctypes.c_size_t(0), _VERSION_FLAG), 0)


def confine(folder: Path) -> None:
    """Confine this process, which has one thread, and all that it starts.

    Parameters
    ----------
    folder
        The one folder that it may write to.

    Raises
    ------
    ConfinementError
        If a part of the confinement is not available or fails; the message names the part.
    """
    number = version()
    if not number:
        raise ConfinementError("this system has no Landlock, or its processor is not x86-64")
    if len(os.listdir("/proc/self/task")) != 1:
        raise ConfinementError("it has several threads")
    _limit_resources()
    libc = _libc()
    handled = next(rights for least, rights in sorted(_FILES.items(), reverse=True) if least <= number)
    rules = _require(libc.syscall(_CREATE, struct.pack("Q", handled), ctypes.c_size_t(8), 0), "Landlock: make rules")
    for path in readable(sys.path):
        _allow(libc, rules, path, _READ & handled)
    _allow(libc, rules, folder, handled)
    _require(libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0), "no new privileges")
    _require(libc.syscall(_RESTRICT, rules, 0), "Landlock: apply rules")
    os.close(rules)
    header = ctypes.create_string_buffer(struct.pack("II", _CAPABILITY_VERSION, 0))
    _require(libc.capset(header, bytes(24)), "drop capabilities")
    _require(filter_system_calls(libc), "seccomp: filter system calls")


def _limit_resources() -> None:
    """Limit memory, processor time and files; short of memory, the kernel ends this process before the verifier."""
    import resource  # does not exist on Windows

    try:
        Path("/proc/self/oom_score_adj").write_text("1000")
    except OSError as error:
        raise ConfinementError(f"/proc/self/oom_score_adj of 1000 fails: {error}") from error

    limits = {"AS": MEMORY_BYTES, "CPU": CPU_S, "FSIZE": FILE_BYTES, "CORE": 0}
    for name, value in limits.items():
        limit = getattr(resource, f"RLIMIT_{name}")
        hard = resource.getrlimit(limit)[1]
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        try:
            resource.setrlimit(limit, (value, value))
        except (OSError, ValueError) as error:
            raise ConfinementError(f"resource limit RLIMIT_{name} of {value} fails: {error}") from error


def readable(import_path: Sequence[str]) -> list[Path]:
    """Folders and files that a confined process can read: Python, its import path and the libraries of the system."""
    rooms = ("dcgrid_env", "dcgrid_env.agents", "dcgrid_env.baselines", "dcgrid_env.traces")
    packages = [place for room in rooms for place in import_module(room).__path__]
    system = ["/usr", "/lib", "/lib64", "/dev/null", "/dev/urandom"]
    places = {sys.prefix, sys.base_prefix, *filter(None, import_path), *packages, *system}
    return [path for path in map(Path, sorted(places)) if path.exists()]


def _allow(libc: ctypes.CDLL, rules: int, path: Path, rights: int) -> None:
    """Give rights below a folder, or over a file."""
    opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        allowed = rights if path.is_dir() else rights & _OF_A_FILE
        _require(libc.syscall(_ADD, rules, _BENEATH, struct.pack("=Qi", allowed, opened), 0), f"Landlock: allow {path}")
    finally:
        os.close(opened)


def _require(result: int, action: str) -> int:
    if result < 0:
        raise ConfinementError(f"{action} fails: {os.strerror(ctypes.get_errno())}")
    return result


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
