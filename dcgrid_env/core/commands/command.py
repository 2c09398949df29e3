"""Base class of the commands of ``dcgrid``; ``dcgrid_command.command_table`` lists them all."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Self

from dcgrid_env.core.commands.option_limits import check_limits
from dcgrid_env.core.commands.options import parsed

GOES_ON = "run the same command again to resume"
"""Message of commands that keep finished work after an interruption."""


class Command(ABC):
    """A command: a frozen dataclass whose docstring is its help and whose fields are its options.

    A field's docstring is the option's help. ``run`` does the work. It raises ValueError or OSError, and the message
    is printed as one line.
    """

    @classmethod
    def about(cls) -> str:
        """Return the help of the command without its options."""
        return inspect.cleandoc(cls.__doc__ or "")

    @classmethod
    def parse(cls, words: Sequence[str], prog: str) -> Self:
        """Parse the words after the command.

        Raises SystemExit if a word is invalid, and after the help, and ValueError for a number outside its limits.
        """
        made = parsed(cls, words, prog, cls.about())
        check_limits(made)
        return made

    @property
    def resumes(self) -> str:
        """Message on how to resume after an interruption; empty if the command keeps no partial results."""
        return ""

    @abstractmethod
    def run(self) -> None:
        """Run the command with the values of its fields."""
