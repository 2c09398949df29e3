"""What each controller costs on a preset, read from what ships: the benchmark's tables and the policies' cards."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

from dcgrid_env.agents import Card
from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.baselines.score import REFERENCE, STATIC, saved_pct

DOCS = Path(__file__).parents[1]
SECTION = re.compile(r"^## ([\w-]+): (\d+) test episodes", re.MULTILINE)
BEST = re.compile(r"^(Hindsight|Best known): J (\d+\.\d+)", re.MULTILINE)


class Row(NamedTuple):
    """A line of the table of headroom."""

    what: str
    """Name of the controller, as Markdown."""
    meaning: str
    j: str
    saved: str
    """J saved, per cent of the tuned droop's."""
    score: str
    """With its 95 % interval."""


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
    """Read what none, the tuned droop, the best constant, hindsight and the best policy score on a preset.

    Raises
    ------
    ValueError
        Where the benchmark's pages have no section of the preset, or no cost of hindsight in it.
    """
    page, episodes, _ = section(preset)
    figures = controllers(preset)
    droop = figures[REFERENCE][0]
    static = max((name for name in STATIC if name in figures), key=lambda name: _leading(figures[name][1]))
    about = {
        "none": "no control: top clock, no reactive power",
        REFERENCE: "the paper's law, gains tuned on validation",
        static: "the best constant: it measures nothing",
    }
    rows = [
        Row(f"`{name}`", meaning, f"{figures[name][0]:.4f}", saved(figures[name][0], droop), figures[name][1])
        for name, meaning in about.items()
    ]
    if card := best_card(preset):
        scored = card.scored
        assert scored is not None
        score, low, high = scored.score
        name, shown = f"`{preset}-{card.algorithm}`", f"{score:.3f} ({low:.3f} to {high:.3f})"
        rows.append(Row(name, "the best policy that ships, trained", f"{scored.J:.4f}", saved(scored.J, droop), shown))
    known, j = hindsight(preset)
    meaning = "the best that is known of each episode, no bound" if known else "perfect foresight of the episode"
    rows.append(Row("best known" if known else "hindsight", meaning, f"{j:.4f}", saved(j, droop), "1"))
    return Headroom(page, episodes, tuple(rows))


def section(preset: str) -> tuple[str, int, str]:
    """Page of the benchmark with a preset, its number of episodes, and the preset's section."""
    if preset not in sections():
        raise ValueError(f"no section '## {preset}: N test episodes' in docs/benchmark*.md; run dcgrid benchmark on it")
    return sections()[preset]


def controllers(preset: str) -> dict[str, tuple[float, str]]:
    """Mean J, and the score with its interval, of each controller that drives a preset."""
    lines = [line.split(" | ") for line in section(preset)[2].splitlines() if line.startswith("| ")]
    lines = [[cell.strip("| ") for cell in line] for line in lines]
    j, score = (lines[0].index(name) for name in ("J", "score"))
    return {line[0]: (float(line[j]), line[score]) for line in lines[1:] if line[j] != "–"}


def hindsight(preset: str) -> tuple[bool, float]:
    """Whether the best known cost replaces hindsight on a preset, and its mean J."""
    page, _, text = section(preset)
    found = BEST.search(text)
    if found is None:
        raise ValueError(f"docs/{page}.md has no cost of hindsight and no best known one for {preset}")
    return found.group(1) == "Best known", float(found.group(2))


def saved(j: float, j_droop: float) -> str:
    """What is saved of the tuned droop's J, %."""
    return f"{saved_pct(j, j_droop):.1f}"


def best_card(preset: str) -> Card | None:
    """Card of the policy that ships with a preset and has the highest score; None where none ships."""
    cards = [Card.load(path) for path in sorted(FOLDER.glob("*.json"))]
    own = [card for card in cards if card.scored is not None and card.scored.scenario == preset]
    return max(own, key=lambda card: card.scored.score[0] if card.scored else -1e9, default=None)


def _leading(cell: str) -> float:
    return float(cell.split()[0]) if re.match(r"-?\d", cell) else float("-inf")
