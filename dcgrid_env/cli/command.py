"""Base class of the commands of ``dcgrid``; ``dcgrid_command.command_table`` lists them all."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Self

from dcgrid_env.cli.options import parsed

GOES_ON = "the same command goes on from there"
"""What a command says that keeps what it has done, and does not do it again."""


class Command(ABC):
    """A command: a frozen dataclass whose docstring is its help and whose fields are its options.

    A field's docstring is the option's help. ``run`` does the work and raises ValueError or OSError, whose message is
    then the one line that the user gets.
    """

    @classmethod
    def about(cls) -> str:
        """What the command does: its whole help but for the options."""
        return inspect.cleandoc(cls.__doc__ or "")

    @classmethod
    def parse(cls, words: Sequence[str], prog: str) -> Self:
        """Read the words after the command; raise SystemExit if a word is wrong, and after the help."""
        return parsed(cls, words, prog, cls.about())

    @property
    def resumes(self) -> str:
        """How to go on after an interruption, as the user is told; empty where nothing has been kept."""
        return ""

    @abstractmethod
    def run(self) -> None:
        """Do what the fields say."""
