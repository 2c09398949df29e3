"""What each controller costs on a preset, read from what ships: the benchmark's tables and the policies' cards."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

from dcgrid_env.agents import Card
from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.baselines.score import REFERENCE, STATIC

DOCS = Path(__file__).parents[1]
SECTION = re.compile(r"^## ([\w-]+): (\d+) test episodes", re.MULTILINE)
BEST = re.compile(r"^(Hindsight|Best known): J (\d+\.\d+)", re.MULTILINE)


class Row(NamedTuple):
    """A line of the table of headroom."""

    what: str
    """Name of the controller, as Markdown."""
    meaning: str
    j: str
    score: str


class Headroom(NamedTuple):
    """What there is to learn on a preset."""

    page: str
    """Page of the benchmark that has every controller, without its suffix."""
    episodes: int
    rows: tuple[Row, ...]


@cache
def sections() -> dict[str, tuple[str, int, str]]:
    """Of each preset the benchmark's page, the number of episodes and the text of its section."""
    found = {}
    for path in sorted(DOCS.glob("benchmark*.md")):
        text = path.read_text(encoding="utf-8")
        heads = list(SECTION.finditer(text))
        ends = [*(head.start() for head in heads[1:]), len(text)]
        for head, end in zip(heads, ends, strict=True):
            found[head.group(1)] = (path.stem, int(head.group(2)), text[head.start() : end])
    return found


def headroom(preset: str) -> Headroom:
    """Read what none, the tuned droop, the best constant, hindsight and the best policy reach on a preset.

    Raises
    ------
    ValueError
        Where the benchmark's pages have no section of the preset, or no cost of hindsight in it.
    """
    if preset not in sections():
        raise ValueError(f"no section '## {preset}: N test episodes' in docs/benchmark*.md; run dcgrid benchmark on it")
    page, episodes, text = sections()[preset]
    best = BEST.search(text)
    if best is None:
        raise ValueError(f"docs/{page}.md has no cost of hindsight and no best known one for {preset}")
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| ")]
    figures = {cells[0]: (cells[1], cells[2]) for cells in lines}
    static = max((name for name in STATIC if name in figures), key=lambda name: _leading(figures[name][0]))
    rows = [
        Row("`none`", "no control: top clock, no reactive power", figures["none"][1], figures["none"][0]),
        Row(f"`{REFERENCE}`", "the paper's law, gains tuned on validation", figures[REFERENCE][1], "0"),
        Row(f"`{static}`", "the best constant: it measures nothing", figures[static][1], figures[static][0]),
    ]
    if card := best_card(preset):
        scored = card.scored
        assert scored is not None
        score, low, high = scored.score
        name = f"`{preset}-{card.algorithm}`"
        shown = f"{score:.3f} ({low:.3f} to {high:.3f})"
        rows.append(Row(name, "the best policy that ships, trained", f"{scored.J:.4f}", shown))
    known = best.group(1) == "Best known"
    meaning = "the best that is known of each episode, no bound" if known else "perfect foresight of the episode"
    rows.append(Row("best known" if known else "hindsight", meaning, best.group(2), "1"))
    return Headroom(page, episodes, tuple(rows))


def best_card(preset: str) -> Card | None:
    """Card of the policy that ships with a preset and has the highest score; None where none ships."""
    cards = [Card.load(path) for path in sorted(FOLDER.glob("*.json"))]
    own = [card for card in cards if card.scored is not None and card.scored.scenario == preset]
    return max(own, key=lambda card: card.scored.score[0] if card.scored else -1e9, default=None)


def _leading(cell: str) -> float:
    return float(cell.split()[0]) if re.match(r"-?\d", cell) else float("-inf")
