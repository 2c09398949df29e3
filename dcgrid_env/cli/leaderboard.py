"""The command ``dcgrid dev leaderboard``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.terminal import plain_console, say


@dataclass(frozen=True)
class Leaderboard(Command):
    """Make the leaderboard's tables from verified folders.

    Runs nothing.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders that dcgrid verify has been through, or folders of such."""
    page: Path = Path("docs/leaderboard.md")
    """Markdown file that has the two marks between which the tables are put."""

    def run(self) -> None:
        """Check, write, print. ValueError for a folder that is not verified, before anything is written."""
        from dcgrid_env.agents.leaderboard.entry_files import SUBMISSION
        from dcgrid_env.agents.leaderboard.page import write_page

        entries: list[Path] = []
        for folder in self.folders:
            below = sorted(path.parent for path in folder.glob(f"*/{SUBMISSION}"))
            entries += [folder] if (folder / SUBMISSION).exists() or not below else below
        n = write_page(entries, self.page)
        say(plain_console(), f"wrote {self.page}: {n} entries")
