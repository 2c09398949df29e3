"""Draw the pictures of presets: python docs/extensions/draw_environments.py FOLDER PRESET..

The pictures are the same as those of ``python -m docs.studies.picture``. Only the kernel that serves requests is
compiled: an environment is used once here, and its 75 steps take less time than compilation.
"""

import os
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

os.environ["MPLBACKEND"] = "agg"
import numba

from dcgrid_env.traces import generate_site

generate_site(60.0, seed=0)  # compiles the kernel that serves requests, millions of them, before the switch
numba.config.DISABLE_JIT = True  # type: ignore[attr-defined]
sys.path.insert(0, str(Path(__file__).parents[2]))
from docs.studies.picture import draw as draw_picture  # noqa: E402  behind the switch, and from the repository

SLOW = ("ieee123-3ph-day", "ieee123-3ph", "bursty", "ride-through")
"""Presets that are slow to draw; they start first and the others run in parallel."""


def draw(folder: str, preset: str) -> None:
    """Draw one picture, whole or not at all."""
    warnings.simplefilter("ignore")  # random numbers wrap around, of which NumPy warns where the compiler does not
    path = Path(folder, f"{preset}.png")
    part = path.with_suffix(".part.png")
    draw_picture(str(part), preset, "droop-tuned")
    part.replace(path)


if __name__ == "__main__":
    folder, presets = sys.argv[1], sorted(sys.argv[2:], key=lambda name: name not in SLOW)
    with ProcessPoolExecutor(min(4, os.cpu_count() or 1), mp_context=get_context("spawn")) as pool:
        for done in [pool.submit(draw, folder, preset) for preset in presets]:
            done.result()
