"""Ctrl-C in a command that runs: never lost, although an exception that comes while a module loads may be."""

from __future__ import annotations

import _thread
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

LONGEST_S = 10.0
"""How long the end of an import is waited for; that of a user's module may never come."""
_AGAIN_S = 0.02


@contextmanager
def interrupted_between_imports() -> Iterator[None]:
    """Let Ctrl-C raise ``KeyboardInterrupt``; while a module loads, once it has loaded.

    Python swallows exceptions in a callback of its import, and libraries swallow some while they load.
    """
    before = signal.getsignal(signal.SIGINT)
    if before == signal.SIG_IGN:  # as a shell has it for what runs in the background
        yield
        return
    main = _thread.get_ident()  # who sets a handler is the main thread
    latest: float | None = None
    asleep = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal latest, asleep
        if asleep:
            return
        latest = latest or time.monotonic() + LONGEST_S
        if time.monotonic() < latest and _loads(frame):
            asleep = True
            _thread.start_new_thread(again, ())
        else:
            latest = None
            raise KeyboardInterrupt

    def again() -> None:
        nonlocal asleep
        time.sleep(_AGAIN_S)
        asleep = False
        if hasattr(signal, "pthread_kill"):  # ends a system call that waits, too
            signal.pthread_kill(main, signal.SIGINT)
        else:
            _thread.interrupt_main()

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _loads(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
