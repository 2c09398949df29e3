"""Print the README's table of results from the benchmark's data files and the policies' cards.

`python -m docs.studies.publishing.headline` prints that; with the word `results` it prints the table of
docs/results.md, from the data files alone, and with the word `tasks` the table of docs/tasks.md.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "extensions"))
from headroom import best_policy, controllers, hindsight, saved  # pyright: ignore[reportMissingImports]

from dcgrid_env import PRESETS
from dcgrid_env.agents import Card
from dcgrid_env.agents.policy.policy import FOLDER, SHIPPED
from dcgrid_env.baselines.score import REFERENCE

SHOWN = ("ieee33-weak", "bursty", "mixed", "wrong-model", "late-measurements", "ieee34-3ph", "routing")
TASKS = ("wrong-model", "late-measurements", "routing", "smoothing", "ride-through", "ieee123-3ph-day")
BY_MODEL = {"model-aided": "model-aided", "mpc-one-step": "one-step MPC"}
BY_HAND = ("constant-q-tuned", "placement-tuned", "model-aided", "feedback", "mpc-one-step", "mpc")
LEARNED = {"ppo": "PPO", "analytic": "analytic", "cem": "CEM"}


def by_model(preset: str, name: str) -> str:
    """Score of a controller with its interval over episodes, and J saved."""
    figures = controllers(preset)
    if name not in figures:
        return "–"
    row = figures[name]
    return cell(row.score, saved(row.means["J"], figures[REFERENCE].means["J"]))


def learned(preset: str, algorithm: str) -> str:
    """Mean score over the training seeds with its interval over seeds and episodes, and J saved in the mean."""
    path = FOLDER / f"{preset}-{algorithm}.json"
    if not path.exists():
        return "–"
    scored = Card.load(path).scored
    assert scored is not None, path
    assert scored.droop_J is not None, path
    assert scored.seed_J is not None, path
    share = saved(float(np.mean(scored.seed_J)), scored.droop_J)
    return cell(scored.over_seeds or scored.score, share) + ("" if scored.over_seeds else ", one seed")


def cell(score: tuple[float, float, float], share: str) -> str:
    """A score with its interval, and J saved."""
    value, low, high = score
    return f"{value:.2f} ({low:.2f} to {high:.2f}); {share} %"


def results() -> str:
    """The table of docs/results.md, as Markdown: every preset, controllers that are not trained."""
    heads = ["scenario", "J: none", "J: droop-tuned", "J: hindsight", "headroom, %", *BY_HAND]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for preset in PRESETS:
        figures, (is_best_known, best) = controllers(preset), hindsight(preset)
        droop = figures[REFERENCE].means["J"]
        cells = [f"`{preset}`", f"{figures['none'].means['J']:.4f}", f"{droop:.4f}"]
        cells += [f"{best:.4f}" + " (best known)" * is_best_known, saved(best, droop)]
        for name in BY_HAND:
            row = figures.get(name)
            cells.append(f"{row.score.value:.2f}; {saved(row.means['J'], droop)} %" if row else "–")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def tasks() -> str:
    """The table of docs/tasks.md, as Markdown: mean J of controllers on the tasks in which learning wins."""
    heads = ["task", "droop-tuned", *BY_MODEL, "best without training", "best policy", "best J possible", "headroom, %"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for preset in TASKS:
        figures, (is_best_known, best) = controllers(preset), hindsight(preset)
        droop = figures[REFERENCE].means["J"]
        cells = [f"`{preset}`", f"{droop:.4f}"]
        cells += [f"{figures[name].means['J']:.4f}" if name in figures else "–" for name in BY_MODEL]
        untrained = min((name for name in figures if name not in SHIPPED), key=lambda name: figures[name].means["J"])
        cells.append(f"{figures[untrained].means['J']:.4f} (`{untrained}`)")
        policy, scored = best_policy(preset)
        cells.append(f"{scored.J:.4f} (`{policy}`)")
        cells += [f"{best:.4f}" + " (best known)" * is_best_known, saved(best, droop)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def table() -> str:
    """The table, as Markdown."""
    heads = ["scenario", "tuned droop: J", "headroom", *BY_MODEL.values(), *LEARNED.values()]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for preset in SHOWN:
        droop = controllers(preset)[REFERENCE].means["J"]
        is_best_known, best = hindsight(preset)
        cells = [f"`{preset}`", f"{droop:.4f}", f"{saved(best, droop)} %" + " (best known)" * is_best_known]
        cells += [by_model(preset, name) for name in BY_MODEL] + [learned(preset, name) for name in LEARNED]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    print({"results": results, "tasks": tasks}.get("".join(sys.argv[1:]), table)())
