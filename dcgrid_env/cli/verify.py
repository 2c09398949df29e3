"""The command ``dcgrid verify``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.terminal import plain_console, say, working


@dataclass(frozen=True)
class Verify(Command):
    """Run an entry of the leaderboard again, on its own episodes and on fresh ones, and write what was found.

    What is found is verified.json in the folder, with a SHA-256 over itself and the hashes of what was run: a file that
    is changed afterwards is noticed. It is no signature of a person; the proof of a figure is this command.
    """

    folder: tyro.conf.Positional[Path]
    """Folder that dcgrid submit wrote."""
    trust: bool = False
    """Whether code of the submitter's own may run."""
    fresh: int = 100
    """Number of fresh episodes: of the test split, not among the claimed ones. Hindsight is not known for them, so that
    they are compared by how much of the tuned droop's J is saved."""
    fresh_seed: int | None = None
    """Seed of the first fresh episode; by default one that follows from the hash of submission.json, which nobody knows
    before the policy is fixed."""

    def run(self) -> None:
        """Check, run, write, print. ValueError for what does not hold; a verified.json that was there then stays."""
        from dcgrid_env.agents.leaderboard.page import Listed
        from dcgrid_env.agents.leaderboard.verifying import verify

        console = plain_console()
        with working(console, f"{self.folder}"):
            entry, found = verify(self.folder, trust=self.trust, fresh=self.fresh, fresh_seed=self.fresh_seed)
        equal = "to the last bit" if found.is_equal_to_the_bit else "within the tolerance"
        value, low, high = found.score
        say(console, f"{entry.name} on {entry.scenario}: found as claimed, {equal}")
        say(console, f"J {found.found.J:.4f}, score {value:.3f} ({low:.3f} .. {high:.3f}), observes: {found.observes}")
        gains = [
            f"{100 * v:.1f} % ({100 * a:.1f} .. {100 * b:.1f})" for v, a, b in (found.found.gain, found.fresh.gain)
        ]
        say(
            console,
            f"saves {gains[0]} of the tuned droop's J; {gains[1]} on {found.fresh_episodes} fresh episodes, seeds from "
            f"{found.fresh_seed}",
        )
        if Listed(entry, found).gains_less:
            say(console, "on fresh episodes it saves less: was it learned or chosen on the test episodes?")
        say(console, f"wrote {self.folder / 'verified.json'}")
