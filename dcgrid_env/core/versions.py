"""Provenance of a result: the command, the versions and the machine."""

from __future__ import annotations

import os
import platform
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.metadata import PackageNotFoundError, version
from typing import Any

PACKAGES = ("dcgrid-env", "numpy", "scipy", "numba", "gymnasium", "pettingzoo")


_words: ContextVar[tuple[str, ...] | None] = ContextVar("words", default=None)
"""Words of the command that runs; None where none was begun by :func:`command_of`."""


@contextmanager
def command_of(words: Sequence[str]) -> Iterator[None]:
    """Have the results of the block say that the command of these words made them."""
    before = _words.set(tuple(words))
    try:
        yield
    finally:
        _words.reset(before)


def command_words() -> tuple[str, ...]:
    """Words of the command that runs, those of the shell unless a command was begun from Python."""
    words = _words.get()
    return ("dcgrid", *sys.argv[1:]) if words is None else words


def versions(packages: tuple[str, ...]) -> dict[str, str | None]:
    """Installed version of each package, None where it is not installed."""
    installed: dict[str, str | None] = {}
    for package in packages:
        try:
            installed[package] = version(package)
        except PackageNotFoundError:
            installed[package] = None
    return installed


def code_block(command: str) -> str:
    """A command as code in Markdown: on one line, line breaks and control characters in its words escaped."""
    return "    " + "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in command)


def meta() -> dict[str, Any]:
    """Command, versions and machine behind a result."""
    return {
        "command": shlex.join(command_words()),
        "versions": {"python": platform.python_version(), **versions(PACKAGES)},
        "machine": {"platform": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
    }
