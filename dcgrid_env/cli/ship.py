"""The command ``dcgrid dev ship``."""

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
    out: Path | None = None
    """Folder to write into; by default that of the policies that ship with the package."""

    def run(self) -> None:
        """Score, write, print. ValueError for runs that do not belong together, before anything is written."""
        from dcgrid_env.agents.policy.policy import FOLDER
        from dcgrid_env.agents.shipping import ship
        from dcgrid_env.cli.listing import card_line

        if self.episodes < 2:
            raise ValueError(f"episodes is {self.episodes}; give at least 2, a score's interval takes them")
        out = self.out or FOLDER
        console = plain_console()
        with working(console, f"{len(self.folders)} policies, {self.episodes} episodes each"):
            card = ship(self.folders, self.name, self.scenario, self.episodes, out)
        say(console, f"{self.name}: {card_line(card)}")
        say(console, f"wrote {out / self.name}.safetensors and .json")


@dataclass(frozen=True)
class Rescore(Command):
    """Score bundled policies again and write their cards.

    Scores them against the tuned droop and hindsight as they are now.

    The costs of the other training seeds on the test split are those of the card.
    """

    names: tyro.conf.Positional[tuple[str, ...]]
    """Names of policies (dcgrid list)."""
    episodes: int | None = None
    """Test episodes: seeds 0, 1, ... Over another number than the card's, the other seeds are left out."""

    def run(self) -> None:
        """Score, write, print. ValueError for a name that no bundled policy has, before anything is written."""
        from dcgrid_env.agents.policy.card import Card
        from dcgrid_env.agents.policy.policy import FOLDER, SHIPPED, Policy
        from dcgrid_env.agents.shipping import rescored
        from dcgrid_env.cli.listing import card_line

        if unknown := [name for name in self.names if name not in SHIPPED]:
            raise ValueError(f"no bundled policy is named {unknown[0]!r}; choose among those of dcgrid list")
        if self.episodes is not None and self.episodes < 2:
            raise ValueError(f"episodes is {self.episodes}; give at least 2, a score's interval takes them")
        for name in self.names:
            path = FOLDER / f"{name}.json"
            card = rescored(Card.load(path), Policy.load(name), self.episodes)
            card.save(path)
            say(plain_console(), f"{name}: {card_line(card)}")
