"""Draw the pictures and animations of presets: python docs/extensions/draw_environments.py FOLDER PRESET..

They are the same as those of ``docs.studies.pictures.picture`` and ``docs.studies.pictures.animation``.
"""

import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

os.environ["MPLBACKEND"] = "agg"
sys.path.insert(0, str(Path(__file__).parents[2]))
from headroom import shown_controller

from docs.studies.pictures.animation import animate
from docs.studies.pictures.picture import draw as draw_picture
from docs.studies.pictures.picture import shown_scenario

SLOW = ("ieee123-3ph-day", "ieee123-3ph", "bursty", "ride-through")
"""Presets that are slow to draw; they start first and the others run in parallel."""


def draw(folder: str, preset: str) -> None:
    """Draw the picture, the animation and its last frame; the animation is complete or missing, and comes last."""
    path = Path(folder, f"{preset}.gif")
    part = path.with_suffix(".part")
    draw_picture(str(path.with_suffix(".png")), preset, "droop-tuned")
    name = shown_controller(preset)
    whole = animate(part, shown_scenario(preset), {"none": "no control", name: name})
    whole.save(path.with_name(f"{preset}-whole.png"), optimize=True)
    part.replace(path)


if __name__ == "__main__":
    folder, presets = sys.argv[1], sorted(sys.argv[2:], key=lambda name: name not in SLOW)
    with ProcessPoolExecutor(min(4, os.cpu_count() or 1), mp_context=get_context("spawn")) as pool:
        for done in [pool.submit(draw, folder, preset) for preset in presets]:
            done.result()
