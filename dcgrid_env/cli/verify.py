"""The command ``dcgrid verify``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.terminal import plain_console, say, working


@dataclass(frozen=True)
class Verify(Command):
    """Run entries of the leaderboard again and report the scores.

    Runs each entry on its own episodes and on fresh ones.

    The report is verified.json in the folder of the entry. It is signed where the verifier's key is there, and only
    signed reports are listed.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders that dcgrid submit wrote."""
    trust: bool = False
    """Whether code of the submitters' own may run, in confined processes."""
    fresh: int | None = None
    """Number of fresh episodes of the test split (default: 100). This command draws their seeds, the same for all
    folders. They have no hindsight, so the share of the tuned droop's J that is saved is compared."""
    again: bool = False
    """Run on the seeds of the signed report instead, and compare with it. Nothing is written."""

    def run(self) -> None:
        """Check, run, write, print. ValueError for what does not hold; a verified.json that was there then stays."""
        from dcgrid_env.agents.leaderboard.verifying import draw_seed

        if not self.folders:
            raise ValueError("folders is empty; give folders that dcgrid submit wrote")
        if self.again and self.fresh is not None:
            raise ValueError(f"fresh is {self.fresh}; leave it out with --again, which takes the report's episodes")
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
        say(console, f"{entry.name} on {entry.scenario}: found as claimed, sent: {found.scope}")
        say(console, f"J {found.found.J:.4f}, score {value:.3f} ({low:.3f} .. {high:.3f})")
        gains = [
            f"{100 * v:.1f} % ({100 * a:.1f} .. {100 * b:.1f})" for v, a, b in (found.found.gain, found.fresh.gain)
        ]
        say(
            console,
            f"saves {gains[0]} of the tuned droop's J; {gains[1]} on {found.fresh_episodes} fresh episodes, seeds from "
            f"{found.fresh_seed}",
        )
        if found.gains_less:
            say(console, "on fresh episodes it saves less: was it learned or chosen on the test episodes?")
        if self.again:
            equal = "to the last bit" if is_equal else "within the tolerance"
            say(console, f"the same as the signed report, {equal}; nothing was written")
        else:
            signed = (
                "signed" if found.signature else f"not signed (no key in {private_key_file()}), so not to be listed"
            )
            say(console, f"wrote {folder / 'verified.json'}, {signed}")
