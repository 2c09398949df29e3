"""Films of episodes: their frames are the viewer's own."""

import importlib.util
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dcgrid_env import DcgridEnv, Recorder
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.rendering.film import frames, write_film


def recorded(scenario, steps, **changes):
    """An episode under random actions, and the viewer's picture of its end."""
    env = DcgridEnv(scenario, render_mode="rgb_array", **changes)
    env.reset(seed=0)
    recorder, rng = Recorder(env.scenario, env.transition), np.random.default_rng(1)
    for _ in range(steps):
        env.step(rng.uniform(-1, 1, env.action_space.shape))
        recorder.add(env.transition)
    return recorder.series(0), env.render()


@pytest.mark.parametrize(("scenario", "steps"), [("toy6", 4), pytest.param("ieee34-3ph", 2, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_frame_is_what_the_environment_draws(scenario, steps):
    run, drawn = recorded(scenario, steps, horizon=5)
    (*_, last) = frames({"random": run})
    np.testing.assert_array_equal(last[40:], drawn)
    assert last[:40].std() > 5.0  # the controller's name


@pytest.mark.skipif(importlib.util.find_spec("imageio") is None, reason=f"imageio not installed; {from_clone('video')}")
@pytest.mark.slow
def test_a_gif_shows_every_so_many_steps_of_all(tmp_path):
    run, _ = recorded("toy6", 5, horizon=5)
    path = write_film(tmp_path / "new" / "a.gif", {"one": run, "two": run}, fps=5.0, every=2)
    film: Any
    with Image.open(path) as film:
        assert film.n_frames == 4  # 0, 2, 4 and the last
        assert film.info["duration"] == 200
        assert film.size == (1152, 356)
    assert [own.name for own in path.parent.iterdir()] == ["a.gif"]


def test_what_is_no_film_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"a film's file ends in \.gif or \.mp4"):
        write_film(tmp_path / "a.avi", {})
    assert not list(tmp_path.iterdir())
