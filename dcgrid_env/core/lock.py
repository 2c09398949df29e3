"""A lock on what a command writes, so that two at once do not write the same; it ends with its process, even a killed
one."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from dcgrid_env.core.user_files import read_json


class LockedError(OSError):
    """Error of a lock that another process has; the message names the process, the time and the remedy."""


@contextmanager
def locked(
    folder: Path, what: str, remedy: str = "give another --out, or wait until it has ended", part: str = ""
) -> Iterator[None]:
    """Lock a folder for the block, and leave no trace of the lock behind.

    The operating system keeps the lock (``filelock``), so one that a killed process held is free. A note next to
    it names process, host and beginning for those who are refused.

    Parameters
    ----------
    folder
        What is held; it must be there.
    what
        Who holds it, for the message: "training", for instance.
    remedy
        What one who is refused can do.
    part
        What is held within the folder; all of it unless given.

    Raises
    ------
    LockedError
        Where another holds it.
    OSError
        Where the folder cannot be written.
    """
    from filelock import Timeout

    lock, note = folder / f"{part}.lock", folder / f"{part}.lock.json"
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(alone(lock, timeout_s=0))
        except Timeout:
            raise LockedError(f"{folder / part.lstrip('.')}: {_holder(note)} writes there; {remedy}") from None
        stack.callback(note.unlink, missing_ok=True)
        began = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
        about = {"what": what, "pid": os.getpid(), "host": socket.gethostname(), "began": began}
        note.write_text(json.dumps(about), encoding="utf-8")
        yield


@contextmanager
def alone(lock: Path, timeout_s: float = -1) -> Iterator[None]:
    """Hold a lock file, waiting so long for it (below 0 without end, else ``filelock.Timeout``), and delete it."""
    from filelock import FileLock

    with FileLock(lock, timeout=timeout_s):
        try:
            yield
        finally:
            # While it is held: one who waits for the deleted file sees that, and makes a new one (filelock 3.21).
            # Where an open file cannot be deleted it stays.
            with contextlib.suppress(OSError):
                lock.unlink()


def _holder(note: Path) -> str:
    """Who holds the lock, as its note says."""
    try:
        about = read_json(note, ValueError, "delete it")
        return f"another {about['what']} (process {about['pid']} on {about['host']}, since {about['began']})"
    except (OSError, ValueError, KeyError, TypeError):  # not written yet, or just gone
        return "another process"
