"""How a command ends: by the file that is worth opening, which ``--open`` opens."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from dcgrid_env.cli.terminal import say

if TYPE_CHECKING:
    from rich.console import Console

_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
"""Variables of which a Unix session has one where something can be opened: without, a browser in text would start."""


def offer(console: Console, path: Path, opens: bool, what: str = "") -> None:
    """Say which file to open, and open it where that is asked for and can be done.

    ``what`` says what else there is to do, and follows on the same line.
    """
    say(console, f"open {path}{what}")
    if opens and not opened(path):
        say(console, f"nothing could be opened from here: no display, or no program for {path.suffix} files")


def opened(path: Path) -> bool:
    """Open a file with what the platform has for it; whether something was started."""
    if sys.platform not in ("darwin", "win32") and not any(map(os.environ.get, _SCREENS)):
        return False
    try:
        return webbrowser.open(path.resolve().as_uri())
    except (webbrowser.Error, OSError):
        return False
