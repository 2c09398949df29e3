"""What the commands say on the terminal: text as it stands, whatever brackets a name of the user's holds."""

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
    """Let standard output show ``?`` for what its encoding lacks, as that of ASCII terminals does."""
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
    """A console on what is standard output now, wherever that of a training goes.

    It shows text as it is: what users name may hold brackets, or ``:key:``.
    """
    from rich.console import Console

    return Console(file=sys.stdout, markup=False, emoji=False, highlight=False)


def say(console: Console, text: str) -> None:
    """Print lines as they are, none folded by us, so that a path or a command can be copied."""
    console.print(text, soft_wrap=True)


def working(console: Console, text: str) -> Status:
    """A context manager that shows what is being done."""
    from rich.text import Text

    return console.status(Text(text))  # a plain string would be read as markup
