"""The animations of the environments' pages: each frame shows the curves up to a time."""

import numpy as np
import pytest
from PIL import Image, ImageSequence

from dcgrid_env import make_scenario
from docs.studies.pictures.animation import COLOURS, FRAME_MS, FRAMES, REST_MS, animate
from docs.studies.pictures.picture import LONGEST, shown_scenario


def columns(frame, colour):
    """Pixel columns that contain a colour, nearly."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    close = np.abs(np.asarray(frame.convert("RGB")).astype(int) - wanted).max(axis=-1) < 12
    return np.flatnonzero(close[60:].any(axis=0))  # below the legend


@pytest.mark.slow
def test_curves_grow_from_left_to_right_until_they_are_whole(tmp_path):
    path = tmp_path / "toy6.gif"
    scenario = make_scenario("toy6", split="test", horizon=12)
    whole = animate(path, scenario, {"none": "no control", "droop": "droop law"})
    with Image.open(path) as gif:
        assert gif.info["loop"] == 0
        frames, durations = [], []
        for frame in ImageSequence.Iterator(gif):
            frames.append(frame.convert("RGB"))
            durations.append(frame.info["duration"])
    assert sum(durations) == FRAMES * FRAME_MS + REST_MS
    assert durations[-1] == REST_MS
    assert np.array_equal(np.asarray(frames[-1]), np.asarray(whole.convert("RGB")))
    for colour in COLOURS[:2]:
        last = [columns(frame, colour).max(initial=0) for frame in frames]
        assert last[0] == 0
        assert last == sorted(last)
        assert last[-1] > 0.95 * whole.width
    assert columns(frames[-1], COLOURS[2]).size == 0
    assert path.stat().st_size < 250_000


def test_long_episodes_are_cut():
    assert shown_scenario("toy6") == make_scenario("toy6", split="test")
    day = shown_scenario("ieee123-3ph-day")
    assert day.horizon <= LONGEST < make_scenario("ieee123-3ph-day").horizon
    assert day.split == "test"
