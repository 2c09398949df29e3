"""The reference of the command line: the help of every command, as the commands print it."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from dcgrid_command.command_table import COMMANDS
from dcgrid_env.cli.main import parse

WIDTH = "80"


def help_of(line: str, text: str) -> str:
    """Return the help of a command, or how to show it if a package for it is not installed."""
    out = io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
            parse([*line.split()[1:], "--help"])
    except ValueError:
        return f"{text}\n\n{line} --help, with the extra agents, shows its options."
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
    for command, member in [("dcgrid", COMMANDS), *COMMANDS.below("dcgrid")]:
        text = help_of(command, member.text)
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
