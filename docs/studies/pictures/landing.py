"""Draw the pictures of the first page.

`python -m docs.studies.pictures.landing docs/images/ieee33-weak.gif` draws the animation, and a path that ends in
results.png the chart of scores.
"""

import re
import sys

import numpy as np
from matplotlib.figure import Figure

from dcgrid_env import make_scenario
from docs.studies.pictures.animation import animate
from docs.studies.publishing.headline import BY_MODEL, LEARNED, by_model, learned
from docs.studies.publishing.headline import SHOWN as PRESETS

SHOWN = {"none": "no control", "droop": "droop law", "analytic": "trained policy"}
"""Label of each controller."""


def chart(path: str) -> None:
    """Write the chart of scores with their intervals, from the cards of bundled policies and the benchmark."""
    figure = Figure(figsize=(8.6, 4.2), dpi=110, layout="constrained")
    ax = figure.subplots()
    methods = BY_MODEL | LEARNED
    colours = ("#666666", "#1A1A1A", "#D55E00", "#0072B2", "#009E73", "#CC79A7")
    for i, ((name, label), colour) in enumerate(zip(methods.items(), colours, strict=True)):
        scored = {preset: interval(preset, name) for preset in PRESETS}
        found = [(place, score) for place, score in enumerate(scored.values()) if score is not None]
        place = np.array([place for place, _ in found]) + 0.15 * (i - 0.5 * (len(methods) - 1))
        value, low, high = np.array([score for _, score in found]).T
        ax.errorbar(
            place, value, (value - low, high - value), fmt="o", color=colour, markersize=5, capsize=2, label=label
        )
    for level, text in ((0.0, "tuned droop"), (1.0, "perfect foresight")):
        ax.axhline(level, color="#888888", linewidth=0.9, linestyle="--")
        ax.annotate(text, (1.0, level), xycoords=("axes fraction", "data"), xytext=(3, 0), textcoords="offset points",
                    va="center", fontsize=8.5, color="#555555")  # fmt: skip
    ax.set_xticks(range(len(PRESETS)), [preset.replace("-", "-\n", 1) for preset in PRESETS], fontsize=9)
    ax.set_ylabel("score (95 % interval)", fontsize=10.5)
    ax.set_ylim(-0.25, 1.12)
    ax.grid(axis="y", alpha=0.25, linewidth=0.6)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, 1.13), ncols=6, frameon=False, fontsize=9, columnspacing=1.0,
              handletextpad=0.2)  # fmt: skip
    figure.savefig(path)


def interval(preset: str, name: str) -> tuple[float, float, float] | None:
    """Return a score and its interval as the README's table has it, None where it has none."""
    text = by_model(preset, name) if name in BY_MODEL else learned(preset, name)
    if not text[0].isdigit() and text[0] != "-":
        return None
    value, low, high = map(float, re.findall(r"-?\d+\.\d+", text)[:3])
    return value, low, high


if __name__ == "__main__":
    if sys.argv[1].endswith("results.png"):
        chart(sys.argv[1])
    else:
        animate(sys.argv[1], make_scenario("ieee33-weak", split="test"), SHOWN)
