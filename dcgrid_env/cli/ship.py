"""The command ``dcgrid ship``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.cli.command import Command
from dcgrid_env.cli.terminal import plain_console, say, working


@dataclass(frozen=True)
class Ship(Command):
    """Score training runs that differ in the seed; write the best.

    They are scored on the test split; the one that is best on validation is written, with its card.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of the runs, one for each seed (dcgrid train)."""
    name: str
    """Name of the policy, by custom SCENARIO-ALGORITHM."""
    scenario: str | None = None
    """Preset on whose test split they are scored; the one of the training unless given."""
    episodes: int = 100
    """Test episodes: seeds 0, 1, ..."""
    out: Path = Path("results/policies")
    """Folder for NAME.safetensors and NAME.json."""

    def run(self) -> None:
        """Score, write, print. ValueError for runs that do not belong together, before anything is written."""
        from dcgrid_env.agents.shipping import ship
        from dcgrid_env.cli.listing import card_line

        if self.episodes < 2:
            raise ValueError(f"episodes is {self.episodes}; give at least 2, a score's interval takes them")
        console = plain_console()
        with working(console, f"{len(self.folders)} policies, {self.episodes} episodes each"):
            card = ship(self.folders, self.name, self.scenario, self.episodes, self.out)
        say(console, f"{self.name}: {card_line(card)}")
        say(console, f"wrote {self.out / self.name}.safetensors and .json")
