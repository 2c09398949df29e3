"""Draw the pictures of the first page.

`python -m docs.studies.landing docs/images/ieee33-weak.gif` draws the animation, and a path that ends in results.png
the chart of scores.
"""

import re
import sys

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

from dcgrid_env import Scenario, make_scenario
from dcgrid_env.baselines import find_controller, rollout
from dcgrid_env.engine.record.episode_record import Series
from docs.studies.headline import BY_MODEL, LEARNED, by_model, learned
from docs.studies.headline import SHOWN as PRESETS

SHOWN = {
    "none": ("no control", "#D55E00"),
    "droop": ("droop law", "#0072B2"),
    "analytic": ("trained policy", "#009E73"),
}
"""Label and colour of each controller."""
EVERY_S = 2
"""Simulated time between frames, s."""
PER_S = 12
"""Frames per second."""
REST = 18
"""Frames in which the end is held."""


def episodes(scenario: Scenario, seed: int) -> dict[str, Series]:
    """Return the same episode under each controller."""
    return {name: rollout(scenario, find_controller(name, scenario), [seed]).series(0) for name in SHOWN}


def animate(path: str, preset: str = "ieee33-weak", seed: int = 0) -> None:
    """Write an animation of an episode: the feeder's lowest voltage and the power of its data centres."""
    scenario = make_scenario(preset, split="test")
    runs = episodes(scenario, seed)
    workload = [device.input == "workload" for device in scenario.devices for _ in range(device.count)]
    t = np.arange(scenario.horizon + 1) * scenario.dt_s
    figure = Figure(figsize=(7.2, 4.6), dpi=100, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1.0])
    edge = 1.0 - scenario.cost.band_pu
    lowest = {name: run.v_pu[:, scenario.feeder.load_slice].min(axis=1) for name, run in runs.items()}
    drawn = {name: run.p_kw[:, workload].sum(axis=1) / 1e3 for name, run in runs.items()}
    bottom = min(float(values.min()) for values in lowest.values()) - 0.008
    above.axhspan(bottom, edge, color="#D00000", alpha=0.08, linewidth=0)
    above.axhline(edge, color="#D00000", linewidth=1.0, linestyle="--")
    above.text(1.0, edge - 0.003, "below the limit", color="#B00000", fontsize=11, va="top")
    above.set_ylim(bottom, 0.995)
    above.set_ylabel("lowest voltage (p.u.)", fontsize=11)
    below.set_ylabel("data centres (MW)", fontsize=11)
    below.set_xlabel("time (s)", fontsize=11)
    below.set_ylim(0.0, 1.15 * max(float(values.max()) for values in drawn.values()))
    below.set_xlim(0.0, t[-1])
    for ax in (above, below):
        ax.grid(alpha=0.25, linewidth=0.6)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=10)
    lines = {}
    for name, (label, colour) in SHOWN.items():
        called = f"{label}: J = {runs[name].metrics()['J']:.2f}"
        lines[name] = (
            above.plot([], [], color=colour, linewidth=2.2, label=called)[0],
            below.step([], [], where="pre", color=colour, linewidth=1.8)[0],
        )
    above.legend(loc="upper center", bbox_to_anchor=(0.5, 1.16), ncols=3, frameon=False, fontsize=11, columnspacing=1.4)

    def show(frame: int) -> None:
        last = min(frame * EVERY_S, scenario.horizon)
        for name, (voltage, power) in lines.items():
            voltage.set_data(t[: last + 1], lowest[name][: last + 1])
            power.set_data(t[1 : last + 1], drawn[name][:last])

    frames = [*range(scenario.horizon // EVERY_S + 1), *[scenario.horizon // EVERY_S] * REST]
    FuncAnimation(figure, show, frames=frames, cache_frame_data=False).save(path, PillowWriter(fps=PER_S))


def chart(path: str) -> None:
    """Write the chart of scores with their intervals, from the cards of bundled policies and the benchmark."""
    figure = Figure(figsize=(7.2, 4.2), dpi=110, layout="constrained")
    ax = figure.subplots()
    methods = BY_MODEL | LEARNED
    colours = ("#666666", "#1A1A1A", "#D55E00", "#0072B2", "#009E73")
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
    ax.set_xticks(range(len(PRESETS)), PRESETS, fontsize=9.5)
    ax.set_ylabel("score (95 % interval)", fontsize=10.5)
    ax.set_ylim(-0.25, 1.12)
    ax.grid(axis="y", alpha=0.25, linewidth=0.6)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, 1.13), ncols=5, frameon=False, fontsize=9, columnspacing=1.0,
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
    draw = chart if sys.argv[1].endswith("results.png") else animate
    draw(sys.argv[1])
