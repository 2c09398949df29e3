"""The command ``dcgrid submit``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say, working


@dataclass(frozen=True)
class Submit(Command):
    """Create an entry for the leaderboard.

    An entry is a folder with a policy, its card and its claimed score. It also contains the hashes of the scenario and
    the episodes, and the package versions. Check it with dcgrid verify.
    """

    policy: tyro.conf.Positional[str]
    """Policy: a policy file, a Stable-Baselines3 model (.zip), a training run's folder, a bundled policy or controller
    (dcgrid list), or your class (file.py:Class, quoted if it takes arguments). For a class, only its file is copied."""
    name: str
    """Name of the entry on the leaderboard."""
    paper: str = ""
    """Reference for the policy: a link or a line of text."""
    scenario: str | None = None
    """Preset to score on. Default: the preset that the policy was trained on."""
    episodes: int = 100
    """Number of test episodes, with seeds 0, 1, ... The leaderboard requires at least 32."""
    learned_on: Literal["train", "validation", "test", "nothing"] = "train"
    """Your declaration of the split used to train, tune or select the policy. Here train includes validation."""
    scope: str = ""
    """Information that a class uses: "local" or "joint", then any of "+ sensitivities", "+ totals", "+ neighbours",
    "+ voltages" and "+ model". For other policies it is measured."""
    out: Path | None = None
    """Folder to create. Default: a folder in results/submissions, named after --scenario and --name."""

    def run(self) -> None:
        """Run, write and print; raise ValueError before writing if the policy cannot be an entry."""
        from dcgrid_env.agents.leaderboard.running import scenario_of, static_evaluations
        from dcgrid_env.agents.leaderboard.submitting import submit
        from dcgrid_env.baselines.evaluation import below_static
        from dcgrid_env.baselines.file_names import file_name

        out = self.out or Path("results/submissions") / file_name("-".join(filter(None, (self.scenario, self.name))))
        console = plain_console()
        with working(console, f"{self.episodes} episodes"):
            entry = submit(
                self.policy, self.name, out, paper=self.paper, scenario=self.scenario, episodes=self.episodes,
                learned_on=self.learned_on, scope=self.scope,
            )  # fmt: skip
            rules = static_evaluations(scenario_of(entry.scenario), range(entry.episodes))
        value, low, high = entry.score
        say(
            console,
            f"{entry.name} on {entry.scenario}: J {entry.claimed.J:.4f}, score {value:.3f} ({low:.3f} .. {high:.3f}), "
            f"information: {entry.scope}",
        )
        if line := below_static(entry.name, {"J": entry.claimed.J}, rules):
            say(console, line)
        say(console, f"wrote {out}; next: dcgrid verify {out}")
