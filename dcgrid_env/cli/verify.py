"""The command ``dcgrid verify``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say, working


@dataclass(frozen=True)
class Verify(Command):
    """Rerun leaderboard entries and report their scores.

    Runs each entry on the claimed episodes and on new ones, and writes the report verified.json to the entry's folder.
    The report is signed if the verifier's key is available. The leaderboard only lists entries with signed reports.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders written by dcgrid submit."""
    trust: bool = False
    """Allow entries with submitted code, which runs in confined processes."""
    fresh: int | None = None
    """Number of new test episodes (default: 100). Their seeds are drawn once for all folders. They have no hindsight
    costs, so the command compares the savings relative to the tuned droop."""
    again: bool = False
    """Repeat the episodes of the signed report and compare with it. Nothing is written."""

    def run(self) -> None:
        """Check, run, write and print; raise ValueError if a claim is wrong, and keep an existing verified.json."""
        from dcgrid_env.agents.leaderboard.verifying import draw_seed

        if not self.folders:
            raise ValueError("folders: must name at least one folder written by dcgrid submit, got none")
        if self.again and self.fresh is not None:
            raise ValueError(
                f"fresh: must not be combined with --again, got {self.fresh}; --again uses the episodes of the report"
            )
        seed = draw_seed()
        for folder in self.folders:
            self._verify(folder, seed)

    def _verify(self, folder: Path, seed: int) -> None:
        from dcgrid_env.agents.leaderboard.signing import private_key_file
        from dcgrid_env.agents.leaderboard.verifying import verify, verify_again

        console = plain_console()
        with working(console, f"{folder}"):
            if self.again:
                entry, found, is_equal = verify_again(folder, trust=self.trust)
            else:
                entry, found = verify(folder, seed, trust=self.trust, fresh=100 if self.fresh is None else self.fresh)
                is_equal = False
        value, low, high = found.score
        say(console, f"{entry.name} on {entry.scenario}: the claim is confirmed, information: {found.scope}")
        say(console, f"J {found.found.J:.4f}, score {value:.3f} ({low:.3f} .. {high:.3f})")
        gains = [
            f"{100 * v:.1f} % ({100 * a:.1f} .. {100 * b:.1f})" for v, a, b in (found.found.gain, found.fresh.gain)
        ]
        say(
            console,
            f"saves {gains[0]} of the tuned droop's J; {gains[1]} on {found.fresh_episodes} new episodes, seeds from "
            f"{found.fresh_seed}",
        )
        if found.gains_less:
            say(
                console,
                "warning: it saves less on new episodes; it may have been trained or selected on the test episodes",
            )
        if self.again:
            equal = "bit for bit" if is_equal else "within the tolerance"
            say(console, f"agrees with the signed report {equal}; nothing was written")
        else:
            signed = (
                "signed"
                if found.signature
                else f"not signed (no key in {private_key_file()}); the leaderboard will not list it"
            )
            say(console, f"wrote {folder / 'verified.json'}, {signed}")
