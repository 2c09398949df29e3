"""The reference of the command line: the help of every command, as the commands print it."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from dcgrid_env.cli.command import Group
from dcgrid_env.cli.main import COMMANDS

WIDTH = "80"


def helps(group: Group, prog: str) -> Iterator[tuple[str, str]]:
    """Every command below a group and its help, commands of maintainers last."""
    for name, member in group.members.items():
        if isinstance(member, Group) or hasattr(member, "members"):
            yield from helps(member, f"{prog} {name}")  # pyright: ignore[reportArgumentType]
        else:
            yield f"{prog} {name}", help_of(member, f"{prog} {name}")


def help_of(member: Any, prog: str) -> str:
    """What ``--help`` of a command prints, or how to see it where that needs what is not installed here."""
    out = io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
            member.parse(["--help"], prog)
    except ValueError:
        return f"{member.about()}\n\n{prog} --help, with the extra agents, shows its options."
    return "\n".join(line.rstrip() for line in out.getvalue().strip().splitlines())


def page() -> str:
    """The page, as reStructuredText."""
    lines = [
        "Command line",
        "============",
        "",
        "What ``--help`` says of each command; ``dcgrid list`` shows names.",
        "",
    ]
    for command, text in helps(COMMANDS, "dcgrid"):
        lines += [
            command,
            "-" * len(command),
            "",
            ".. code-block:: text",
            "",
            *(f"   {line}" for line in text.splitlines()),
        ]
        lines.append("")
    return "\n".join(lines)


def make(app: Sphinx) -> None:
    """Write the page before the sources are read."""
    before = {name: os.environ.get(name) for name in ("COLUMNS", "NO_COLOR")}
    os.environ.update(COLUMNS=WIDTH, NO_COLOR="1")
    try:
        text = page()
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
    path = Path(app.srcdir) / "api" / "command-line.rst"
    path.parent.mkdir(exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Make the page when the builder is there."""
    app.connect("builder-inited", make)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
