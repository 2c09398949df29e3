"""What a command of ``dcgrid`` is, and how commands stand in groups."""

from __future__ import annotations

import functools
import inspect
import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, make_dataclass
from typing import Annotated, Any, Protocol, Self

import tyro

GOES_ON = "the same command goes on from there"
"""What a command says that keeps what it has done, and does not do it again."""
PLAIN = (tyro.conf.OmitSubcommandPrefixes,)


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
        """Read the words that follow the command's own; SystemExit for words that cannot be, or after the help."""
        return tyro.cli(cls, args=words, prog=prog, description=cls.about(), config=PLAIN)

    @property
    def resumes(self) -> str:
        """How to go on after an interruption, as the user is told; empty where nothing has been kept."""
        return ""

    @abstractmethod
    def run(self) -> None:
        """Do what the fields say."""


class Member(Protocol):
    """What may stand in a group: a class of commands, a group, or something that finds its options when asked."""

    def about(self) -> str:
        """What it does."""
        ...

    def parse(self, words: Sequence[str], prog: str) -> Command:
        """Read the words that follow its own."""
        ...


@dataclass(frozen=True)
class Group:
    """Commands under a common first word, by their names."""

    text: str
    """What they are for."""
    members: Mapping[str, Member]
    moved: Mapping[str, str] = field(default_factory=dict)
    """Commands that stood here once, and what they are called now."""

    def about(self) -> str:
        """What the commands are for."""
        return self.text

    def parse(self, words: Sequence[str], prog: str) -> Command:
        """Read a command and its options.

        ValueError for a command that there is not, saying where it stands if it is in a group below; SystemExit for
        words that cannot be, or after the help.
        """
        first = words[0] if words else ""
        if first in self.members:
            return self.members[first].parse(words[1:], f"{prog} {first}")
        if first and not first.startswith("-"):
            below = self.moved.get(first) or "` or `".join(self._below(first, prog))
            raise ValueError(
                f"there is no `{prog} {first}`; it is `{below}`" if below else
                f"`{prog}` has no command {first!r}; there are {', '.join(self.members)}"
            )  # fmt: skip
        self._page(words, prog)
        raise ValueError(f"`{prog}` takes a command; there are {', '.join(self.members)}")

    def _below(self, name: str, prog: str) -> Any:
        """Where commands of a name stand in the groups of this one."""
        for word, member in self.members.items():
            if isinstance(member, Group) and name in member.members:
                yield f"{prog} {word} {name}"

    def _page(self, words: Sequence[str], prog: str) -> None:
        """Show the help, or what is wrong with options that come before a command."""
        listed: list[Any] = [
            Annotated[
                make_dataclass(name, ()), tyro.conf.subcommand(name, description=member.about().partition("\n\n")[0])
            ]
            for name, member in self.members.items()
        ]
        any_of = functools.reduce(operator.or_, listed)
        tyro.cli(any_of, args=words, prog=prog, description=self.about(), config=PLAIN)
