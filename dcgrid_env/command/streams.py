"""Standard streams of a command: closed ones, a reader that stops, and a device without space."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

UNREAD = 141
"""Status that shells give to what has ended because nobody reads its output."""


@contextmanager
def standard_streams() -> Iterator[None]:
    """Run a command with three open streams; end with status 141 where whoever reads standard output stops.

    A stream that the shell has closed leads to the null device, so no file that the command opens takes its number.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            _to_null(number)
            setattr(sys, name, os.fdopen(os.dup(number), "w" if number else "r", encoding="utf-8"))
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        _to_null(1)  # for what is flushed when Python ends
        raise SystemExit(UNREAD) from None
    except OSError:
        try:
            sys.stdout.flush()
        except OSError:  # no space is left where standard output goes
            _to_null(1)
        raise


def complain(text: str) -> None:
    """Print a line on standard error, in vain if that cannot be written."""
    try:
        print(text, file=sys.stderr, flush=True)
    except OSError:
        _to_null(2)


def _to_null(number: int) -> None:
    opened = os.open(os.devnull, os.O_RDWR)
    if opened == number:
        os.set_inheritable(number, True)
        return
    os.dup2(opened, number)
    os.close(opened)
