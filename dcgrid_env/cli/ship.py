"""Score training runs that differ in the seed alone on the test split; write the best on validation with its card."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dcgrid_env.cli.terminal import plain_console, say, working


@dataclass(frozen=True)
class Ship:
    """What to ship."""

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of the runs, one for each seed (dcgrid train)."""
    name: str
    """Of the policy, SCENARIO-ALGORITHM by custom."""
    scenario: str | None = None
    """Preset on whose test split they are scored; the one of the training unless given."""
    episodes: int = 100
    """Test episodes: seeds 0, 1, ..."""
    out: Path | None = None
    """Folder to write into; by default that of the policies that ship with the package."""


def main(cfg: Ship) -> None:
    """Score, write, print. ValueError for runs that do not belong together, before anything is written."""
    from dcgrid_env.agents.policy.policy import FOLDER
    from dcgrid_env.agents.shipping import ship
    from dcgrid_env.cli.listing import card_line

    if cfg.episodes < 2:
        raise ValueError(f"episodes is {cfg.episodes}; give at least 2, a score's interval takes them")
    out = cfg.out or FOLDER
    console = plain_console()
    with working(console, f"{len(cfg.folders)} policies, {cfg.episodes} episodes each"):
        card = ship(cfg.folders, cfg.name, cfg.scenario, cfg.episodes, out)
    say(console, f"{cfg.name}: {card_line(card)}")
    say(console, f"wrote {out / cfg.name}.safetensors and .json")
