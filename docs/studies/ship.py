"""Score the training runs of several seeds and save the best as a policy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.core.commands.command import Command
from dcgrid_env.core.commands.terminal import plain_console, say, working


@dataclass(frozen=True)
class Ship(Command):
    """Score training runs with different seeds; save the best.

    All runs are scored on the test split. The run with the best validation cost is saved as a policy, with its card.
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of training runs (dcgrid train), one for each seed."""
    name: str
    """Name of the policy, usually SCENARIO-ALGORITHM."""
    scenario: str | None = None
    """Preset to score on. Default: the preset of the training."""
    episodes: int = 100
    """Number of test episodes, at least 2, with seeds 0, 1, ..."""
    out: Path = Path("results/policies")
    """Folder for NAME.safetensors and NAME.json."""

    def run(self) -> None:
        """Score, write and print; raise ValueError before writing if the runs do not belong together."""
        from dcgrid_env.cli.listing import card_line
        from docs.studies.shipping import ship

        if self.episodes < 2:
            raise ValueError(f"episodes: must be at least 2 for a score's interval, got {self.episodes}")
        console = plain_console()
        with working(console, f"{len(self.folders)} policies, {self.episodes} episodes each"):
            card = ship(self.folders, self.name, self.scenario, self.episodes, self.out)
        say(console, f"{self.name}: {card_line(card)}")
        say(console, f"wrote {self.out / self.name}.safetensors and .json")
