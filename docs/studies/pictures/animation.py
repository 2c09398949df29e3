"""Animate an episode without control and under controllers: the feeder's voltages and the power of the data centres.

`python -m docs.studies.pictures.animation PATH SCENARIO CONTROLLER..` writes the GIF.
"""

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from dcgrid_env import Scenario
from dcgrid_env.baselines import find_controller, rollout
from dcgrid_env.engine.record.episode_record import Series
from docs.studies.pictures.picture import shown_scenario

COLOURS = ("#D55E00", "#0072B2", "#009E73")
LIMIT = "#D00000"
FRAMES = 60
FRAME_MS = 80
REST_MS = 1500
"""Time for which the whole episode is shown."""
PALETTE = 64
"""Number of colours of the file."""


def animate(path: str | Path, scenario: Scenario, labels: Mapping[str, str], seed: int = 0) -> Image.Image:
    """Write a GIF of an episode under several controllers.

    The figure is drawn twice, with and without the curves. Each frame shows the curves up to a time.

    Parameters
    ----------
    path
        Name of the file.
    scenario
        Scenario of the episode.
    labels
        Label of each controller, by its name.
    seed
        Seed of the episode.

    Returns
    -------
    Image.Image
        The last frame.
    """
    runs = {
        label: rollout(scenario, find_controller(name, scenario), [seed]).series(0) for name, label in labels.items()
    }
    figure = Figure(figsize=(7.2, 4.4), dpi=100, layout="constrained")
    curves = draw(figure, runs)
    bbox = figure.axes[-1].bbox
    whole = pixels(figure)
    for curve in curves:
        curve.set_visible(False)
    both = Image.fromarray(np.vstack((whole, pixels(figure)))).quantize(PALETTE)  # with the same colours
    height, width = whole.shape[:2]
    last, empty = both.crop((0, 0, width, height)), both.crop((0, height, width, 2 * height))
    frames = [empty.copy() for _ in range(FRAMES)]
    for frame, edge in zip(frames, np.linspace(bbox.x0, bbox.x1, FRAMES, endpoint=False).astype(int), strict=True):
        frame.paste(last.crop((0, 0, edge, height)))
    durations = [*[FRAME_MS] * FRAMES, REST_MS]
    frames[0].save(path, "GIF", save_all=True, append_images=[*frames[1:], last], duration=durations, loop=0)
    return last


def pixels(figure: Figure) -> np.ndarray:
    """Render a figure as (height, width, 3), uint8."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def draw(figure: Figure, runs: Mapping[str, Series]) -> list[Artist]:
    """Draw the same episode under each controller and return the curves."""
    scenario = next(iter(runs.values())).scenario
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.6, 1.0])
    workload = [device.input == "workload" for device in scenario.devices for _ in range(device.count)]
    curves: list[Artist] = []
    for colour, (label, run) in zip(COLOURS, runs.items(), strict=False):
        t = np.arange(len(run.v_pu)) * scenario.dt_s
        v = run.v_pu[:, scenario.feeder.load_slice]
        label = f"{label}: J = {run.metrics()['J']:.2f}"
        curves += above.plot(t, v.min(axis=1), color=colour, linewidth=2.2, label=label)
        curves += above.plot(t, v.max(axis=1), color=colour, linewidth=1.0)
        power = run.p_kw[:, workload].sum(axis=1) / 1e3
        curves += below.step(t, np.append(power[0], power), where="pre", color=colour, linewidth=1.8)
    bottom, top = above.get_ylim()
    for sign in (-1.0, 1.0):
        edge = 1.0 + sign * scenario.cost.band_pu
        above.axhline(edge, color=LIMIT, linewidth=1.0, linestyle="--")
        above.axhspan(edge, edge + sign, color=LIMIT, alpha=0.08, linewidth=0)
    above.set_ylim(min(bottom, 1.0 - 1.1 * scenario.cost.band_pu), top)
    above.set_ylabel("lowest and highest\nvoltage (p.u.)", fontsize=11)
    below.set_ylabel("data centres\n(MW)", fontsize=11)
    below.set_xlabel("time (s)", fontsize=11)
    below.set_ylim(bottom=0.0)
    below.set_xlim(0.0, scenario.horizon * scenario.dt_s)
    for ax in (above, below):
        ax.grid(alpha=0.25, linewidth=0.6)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=10)
    figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False, fontsize=11)
    return curves


if __name__ == "__main__":
    path, preset, *controllers = sys.argv[1:]
    animate(path, shown_scenario(preset), {"none": "no control"} | {name: name for name in controllers})
