"""The command ``dcgrid submit``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.terminal import plain_console, say, working


@dataclass(frozen=True)
class Submit(Command):
    """Write an entry of the leaderboard.

    An entry is a folder with a policy, its card and the score that is claimed.

    The folder holds the hashes of scenario and episodes and the versions that the figures were made with. dcgrid verify
    runs it again.
    """

    policy: tyro.conf.Positional[str]
    """A policy's file, a training run's folder, a policy that ships or a controller (dcgrid list), or a class of your
    own (file.py:Class, in quotes with arguments), whose file alone goes into the folder."""
    name: str
    """What the entry is called on the page."""
    paper: str = ""
    """Where it is described: a link, or a line of text."""
    scenario: str | None = None
    """Preset on whose test split it is scored; the one that the policy was trained on unless given."""
    episodes: int = 100
    """Test episodes: seeds 0, 1, ... The page takes entries of at least 32."""
    learned_on: Literal["train", "validation", "test", "nothing"] = "train"
    """Split that the policy was learned, tuned or selected on, as you declare it: train means train and validation."""
    scope: str = ""
    """Scope of a class, the part of an episode that it is sent: "local" or "joint", then any of "+ sensitivities",
    "+ totals", "+ neighbours" or "+ voltages", and "+ model". The scope of other controllers is measured."""
    out: Path | None = None
    """Folder to be made; by default one in results/submissions, named after --scenario and --name."""

    def run(self) -> None:
        """Run, write, print. ValueError for what cannot be entered, before anything is written."""
        from dcgrid_env.agents.leaderboard.submitting import submit
        from dcgrid_env.baselines.file_names import file_name

        out = self.out or Path("results/submissions") / file_name("-".join(filter(None, (self.scenario, self.name))))
        console = plain_console()
        with working(console, f"{self.episodes} episodes"):
            entry = submit(
                self.policy, self.name, out, paper=self.paper, scenario=self.scenario, episodes=self.episodes,
                learned_on=self.learned_on, scope=self.scope,
            )  # fmt: skip
        value, low, high = entry.score
        say(
            console,
            f"{entry.name} on {entry.scenario}: J {entry.claimed.J:.4f}, score {value:.3f} ({low:.3f} .. {high:.3f}), "
            f"sent: {entry.scope}",
        )
        say(console, f"wrote {out}; next: dcgrid verify {out}")
