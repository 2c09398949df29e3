"""Print the path of a command's main output file, and open it with ``--open``."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from dcgrid_env.core.commands.terminal import say

if TYPE_CHECKING:
    from rich.console import Console

_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
"""Environment variables of Unix sessions with a display; without one, ``webbrowser`` would start a text browser."""


def offer(console: Console, path: Path, opens: bool, what: str = "") -> None:
    """Print which file to open, and open it if ``opens`` is set and a display is available.

    ``what`` is appended to the line.
    """
    say(console, f"open {path}{what}")
    if opens and not opened(path):
        say(console, f"could not open the file: no display, or no program for {path.suffix} files")


def opened(path: Path) -> bool:
    """Open a file with the platform's default program; return whether a program was started."""
    if sys.platform not in ("darwin", "win32") and not any(map(os.environ.get, _SCREENS)):
        return False
    try:
        return webbrowser.open(path.resolve().as_uri())
    except (webbrowser.Error, OSError):
        return False
