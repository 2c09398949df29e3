"""Groups of commands: how words lead to a command, and the page that lists the commands of a group.

Nothing here loads ``dcgrid_env`` before a command runs, so that a page is shown at once.
"""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple

HELP = ("-h", "--help")
_WIDEST = 100
"""Columns of a page on a wide terminal."""


class Entry(NamedTuple):
    """A command in the table."""

    text: str
    """Summary on one line; the docstring of the class begins with it."""
    where: str
    """Its class, ``module:Class`` in the package, which has ``parse(words, prog)``."""
    package: str = "dcgrid_env"

    def load(self) -> Any:
        """Import its class."""
        module, _, name = self.where.partition(":")
        return getattr(import_module(f"{self.package}.{module}"), name)


class Group(NamedTuple):
    """Commands under a common first word."""

    text: str
    """Their purpose, on one line."""
    sections: Mapping[str, Mapping[str, Entry | Group]]
    """Commands by name, by the heading that they have on the page."""
    options: Mapping[str, str] = {}
    """Options of the group, and what each does."""

    @property
    def members(self) -> dict[str, Entry | Group]:
        """All commands by name."""
        return {name: member for section in self.sections.values() for name, member in section.items()}

    def below(self, prog: str) -> Iterator[tuple[str, Entry | Group]]:
        """Every command and group below this one, with the words that call it."""
        for name, member in self.members.items():
            yield f"{prog} {name}", member
            if isinstance(member, Group):
                yield from member.below(f"{prog} {name}")

    def page(self, prog: str) -> str:
        """The help: the commands in their sections, as wide as the terminal."""
        width = max(40, min(shutil.get_terminal_size().columns, _WIDEST))
        sections = {
            title: {name: member.text for name, member in part.items()} for title, part in self.sections.items()
        }
        sections["Options"] = {", ".join(HELP): "Show this help and exit.", **self.options}
        longest = max(len(name) for part in sections.values() for name in part) + 4
        lines = [f"usage: {prog} COMMAND [OPTIONS]", "", *textwrap.wrap(self.text, width)]
        for title, part in sections.items():
            lines += ["", f"{title}:"]
            for name, text in part.items():
                start, indent = f"  {name}".ljust(longest), " " * longest
                lines += textwrap.wrap(text, width, initial_indent=start, subsequent_indent=indent)
        return "\n".join([*lines, "", f"Run `{prog} COMMAND --help` for the options of a command."])


def resolve(root: Group, prog: str, words: Sequence[str]) -> tuple[Entry | Group, str, Sequence[str]]:
    """What words lead to, the words that lead there, and those that follow: a group's begin with no command of it."""
    member: Entry | Group = root
    while isinstance(member, Group) and words and words[0] in member.members:
        member, prog, words = member.members[words[0]], f"{prog} {words[0]}", words[1:]
    return member, prog, words


def help_page(root: Group, prog: str, words: Sequence[str]) -> str | None:
    """The page of the group that words lead to, where they ask for its help; else None."""
    member, prog, rest = resolve(root, prog, words)
    return member.page(prog) if isinstance(member, Group) and rest and rest[0] in HELP else None
