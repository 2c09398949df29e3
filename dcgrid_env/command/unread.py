"""Standard output of a command whose reader stops."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

UNREAD = 141
"""Status that shells give to what has ended because nobody reads its output."""


@contextmanager
def ends_unread() -> Iterator[None]:
    """End in silence where whoever reads standard output stops, as ``head`` does after its lines."""
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is flushed when Python ends
        raise SystemExit(UNREAD) from None
