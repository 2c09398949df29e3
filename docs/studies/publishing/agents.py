"""Print docs/training.md's table of the policies that ship, from their cards.

Use: `python -m docs.studies.publishing.agents`.
"""

import numpy as np

from dcgrid_env import PRESETS
from dcgrid_env.agents import Card
from dcgrid_env.agents.policy.policy import FOLDER
from dcgrid_env.baselines.score import saved_pct

ALGORITHMS = ("analytic", "ppo", "safe", "cem", "affine")
"""Algorithms of which policies ship, in the order of tables."""


def cells(scenario: str, algorithm: str) -> list[str]:
    """Score with interval, mean over seeds with its interval and their number, J saved in that mean, delay, minutes."""
    path = FOLDER / f"{scenario}-{algorithm}.json"
    if not path.exists():
        return [""] * 5
    card = Card.load(path)
    found = card.scored
    assert found is not None, path
    assert found.droop_J is not None, path
    assert found.seed_J is not None, path
    score, low, high = found.score
    mean, least, most = found.over_seeds or found.score
    return [
        f"{score:.2f} ({low:.2f} .. {high:.2f})",
        f"{mean:.2f} ({least:.2f} .. {most:.2f}; {len(found.seed_scores)})",
        f"{saved_pct(np.mean(found.seed_J), found.droop_J):.1f}",
        f"{found.delay_mean_s:.2f}",
        f"{(card.training_s or 0) / 60:.1f}",
    ]


def droop_delay(scenario: str) -> str:
    """Mean delay under the tuned droop, s."""
    for algorithm in ALGORITHMS:
        path = FOLDER / f"{scenario}-{algorithm}.json"
        if path.exists() and (found := Card.load(path).scored):
            return f"{found.droop_delay_mean_s:.2f}"
    return ""


def table() -> str:
    """The table, as Markdown: a row for each preset with policies."""
    shown = [a for a in ALGORITHMS if any(FOLDER.glob(f"*-{a}.json"))]
    head = [title for a in shown for title in (a, "seeds", "J saved, %", "delay, s", "min")]
    lines = ["| scenario | " + " | ".join([*head, "droop-tuned: delay, s"]) + " |", "|---|" + "---|" * (len(head) + 1)]
    for name in PRESETS:
        row = [cell for a in shown for cell in cells(name, a)]
        if not any(row):
            continue
        lines.append(f"| `{name}` | " + " | ".join([*row, droop_delay(name)]) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())
