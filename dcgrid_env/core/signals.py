"""Signals that end a command: none is lost while a module loads or a kernel compiles, when exceptions may be."""

from __future__ import annotations

import _thread
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

LONGEST_S = 10.0
"""Longest wait for the end of an import or of a kernel's compilation; that of a user's module may never come."""
_AGAIN_S = 0.02
_IMPORT, _COMPILER = "<frozen importlib", f"{os.sep}llvmlite{os.sep}"


@contextmanager
def raising(number: int, error: type[BaseException] | BaseException) -> Iterator[None]:
    """Let a signal raise an exception; while a module loads or a kernel compiles, after that.

    Python swallows exceptions in a callback of its import, as ctypes does in those of the compiler, and libraries
    swallow some while they load.
    """
    before = signal.getsignal(number)
    if before == signal.SIG_IGN:  # as a shell has SIGINT for what runs in the background
        yield
        return
    main = _thread.get_ident()  # who sets a handler is the main thread
    latest: float | None = None
    asleep = False

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal latest, asleep
        if asleep:
            return
        latest = latest or time.monotonic() + LONGEST_S
        if time.monotonic() < latest and _swallows(frame):
            asleep = True
            _thread.start_new_thread(again, ())
        else:
            latest = None
            raise error

    def again() -> None:
        nonlocal asleep
        time.sleep(_AGAIN_S)
        asleep = False
        if hasattr(signal, "pthread_kill"):  # ends a system call that waits, too
            signal.pthread_kill(main, number)
        else:
            _thread.interrupt_main(signal.Signals(number))

    signal.signal(number, handle)
    try:
        yield
    finally:
        signal.signal(number, before)


def _swallows(frame: FrameType | None) -> bool:
    while frame is not None:
        name = frame.f_code.co_filename
        if name.startswith(_IMPORT) or _COMPILER in name:
            return True
        frame = frame.f_back
    return False


@contextmanager
def terminated_in_order() -> Iterator[None]:
    """Let SIGTERM end the process by an exception, so incomplete files are removed, as after Ctrl-C."""
    try:
        with raising(signal.SIGTERM, Terminated(128 + signal.SIGTERM)):
            yield
    except Terminated as terminated:
        raise SystemExit(terminated.args[0]) from None


class Terminated(BaseException):
    """SIGTERM has come; not SystemExit, which user code may raise, and which is then a failure of that code."""
