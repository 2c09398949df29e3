"""Print text on the terminal unchanged, including brackets in user-supplied names."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.status import Status


@contextmanager
def any_characters() -> Iterator[None]:
    """Print ``?`` for characters that the encoding of standard output lacks, for example on ASCII terminals."""
    output = sys.stdout
    if not isinstance(output, TextIOWrapper):
        yield
        return
    errors = output.errors
    output.reconfigure(errors="replace")
    try:
        yield
    finally:
        output.reconfigure(errors=errors)


def plain_console() -> Console:
    """Return a console on the current standard output that prints text unchanged.

    User-supplied names may contain brackets or ``:key:``, which rich would read as markup or emoji.
    """
    from rich.console import Console

    class _Console(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return _Console(file=sys.stdout, markup=False, emoji=False, highlight=False)


def say(console: Console, text: str) -> None:
    """Print lines without wrapping them, so paths and commands can be copied."""
    console.print(text, soft_wrap=True)


def working(console: Console, text: str) -> Status:
    """Return a context manager that shows a status line."""
    from rich.text import Text

    return console.status(Text(text))  # rich would read a plain string as markup
