"""The command ``dcgrid verify``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.apps.leaderboard.entries import REPORT
from dcgrid_env.apps.leaderboard.rounds import LEAST_EPISODES, verify, verify_again
from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say, working


@dataclass(frozen=True)
class Verify(Command):
    """Score leaderboard entries in a round and write reports.

    All entries of a preset run on the same new test episodes, whose seeds follow from --round-seed. The command writes
    the report verified.json to each entry's folder.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders written by dcgrid submit."""
    round_seed: int | None = None
    """Number of the round, published on the leaderboard's page after the round has closed. For a trial: any number."""
    episodes: int | None = None
    """Number of episodes, 256 to 1024 (default: 256). With --again: the first episodes of the report (default: all)."""
    trust: bool = False
    """Run entries with submitted code. Read the code, and use a container (docs/leaderboard.md)."""
    again: bool = False
    """Repeat the episodes of the report and compare the costs. Nothing is written."""

    def run(self) -> None:
        """Check, run, write and print; raise ValueError for an invalid entry, and keep an existing verified.json."""
        if not self.folders:
            raise ValueError("folders: must name at least one folder written by dcgrid submit, got none")
        if self.again == (self.round_seed is not None):
            raise ValueError(
                f"round_seed: must be a number, or use --again to repeat a report, got {self.round_seed}"
                f"{' and --again' if self.again else ''}"
            )
        for folder in self.folders:
            self._verify(folder)

    def _verify(self, folder: Path) -> None:
        console = plain_console()
        if self.round_seed is None:
            with working(console, f"{folder}"):
                entry, _, n = verify_again(folder, self.episodes, trust=self.trust)
            say(console, f"{entry.name} on {entry.scenario}: {n} episodes agree with the report; nothing was written")
            return
        with working(console, f"{folder}"):
            n = LEAST_EPISODES if self.episodes is None else self.episodes
            entry, report = verify(folder, self.round_seed, n, trust=self.trust)
        value, low, high = report.saved_pct
        say(
            console,
            f"{entry.name} on {entry.scenario}: saves {value:.2f} % ({low:.2f} .. {high:.2f}) of the tuned droop's J, "
            f"information: {report.information}",
        )
        say(console, f"wrote {folder / REPORT}: {n} episodes of round {report.round_seed}")
