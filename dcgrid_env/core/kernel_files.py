"""The folders in which the machine code of kernels is kept: one file for each kernel and signature.

A file's name contains a hash of all that its code depends on (``compiled``), so files of several versions and
processes never conflict. A file starts with the hash of its content, so a damaged one is recognised.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import multiprocessing
import os
import stat
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

from dcgrid_env.core.files import write_bytes

SUFFIX = ".kernel"
DAY_S = 86_400
UNUSED_S = 30 * DAY_S
"""A file that no process has read for so long is deleted."""

_refused: dict[Path, OSError] = {}
"""Folders that cannot be used at all, and why."""
_unwritable: set[Path] = set()
_pruned: set[Path] = set()


def read(name: str) -> bytes | None:
    """Return the content of an intact file, or None."""
    for folder in folders():
        path = folder / (name + SUFFIX)
        try:
            data = path.read_bytes()
            if time.time() - path.stat().st_mtime > DAY_S:
                with contextlib.suppress(OSError):  # readable, but not ours
                    os.utime(path)
        except OSError:
            continue
        if data[:32] == hashlib.sha256(data[32:]).digest():
            return data[32:]
    return None


def write(name: str, content: bytes) -> None:
    """Write a file into the first folder that can be written; report on stderr once where another one has to do."""
    data = hashlib.sha256(content).digest() + content
    usable = folders()
    for folder, error in _refused.items():
        if folder not in _unwritable:
            _unwritable.add(folder)
            _report(folder, error)
    for folder in usable:
        if folder in _unwritable:
            continue
        try:
            write_bytes(folder / (name + SUFFIX), data)
        except OSError as error:
            _unwritable.add(folder)
            _report(folder, error)
            continue
        _prune(folder)
        return


@cache
def folders() -> list[Path]:
    """Return the folders to read from and write to, the preferred one first; each belongs to this user alone."""
    import platformdirs

    chosen = os.environ.get("NUMBA_CACHE_DIR")
    user = os.getuid() if hasattr(os, "getuid") else None  # on Windows the temporary folder is the user's
    preferred = (Path(chosen) / "dcgrid" if chosen else platformdirs.user_cache_path("dcgrid")) / "kernels"
    candidates = [preferred]
    with contextlib.suppress(FileNotFoundError):  # there is no temporary folder
        name = "dcgrid-kernels" if user is None else f"dcgrid-kernels-{user}"
        candidates.append(Path(tempfile.gettempdir()) / name)
    found = []
    for folder in candidates:
        try:
            _make_private(folder, user)
        except OSError as error:
            _refused[folder] = error
        else:
            found.append(folder)
    return found


def _make_private(folder: Path, user: int | None) -> None:
    """Make a folder; OSError if that fails, or if another user but root can write it.

    The files are pickles, so a folder that others can write would run their code.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    status = folder.lstat()
    is_others = user is not None and (status.st_uid not in (user, 0) or status.st_mode & 0o022)
    if not stat.S_ISDIR(status.st_mode) or is_others:
        raise PermissionError(errno.EPERM, "belongs to another user or can be written by others")


def _report(folder: Path, error: OSError) -> None:
    """Say on stderr that a folder cannot be written, and what is used instead."""
    if multiprocessing.parent_process() is not None:
        return
    other = next((other for other in folders() if other not in _unwritable), None)
    instead = f"using {other}" if other else "kernels are compiled again by each process"
    remedy = "set NUMBA_CACHE_DIR to a writable folder to keep them"
    print(f"dcgrid: {folder}: {error.strerror or error}; {instead}; {remedy}.", file=sys.stderr)


def _prune(folder: Path) -> None:
    """Delete files that no process has read for a long time, once per process."""
    if folder in _pruned:
        return
    _pruned.add(folder)
    oldest = time.time() - UNUSED_S
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            with contextlib.suppress(OSError):  # deleted by another process
                if path.stat().st_mtime < oldest:
                    path.unlink()
