"""RecordVideo of gymnasium, with what the ``video`` extra installs."""

import importlib
import importlib.util

import gymnasium
import pytest

from dcgrid_env.core.suggestions import from_clone


@pytest.mark.skipif(importlib.util.find_spec("moviepy") is None, reason=f"moviepy not installed; {from_clone('video')}")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of moviepy's own
def test_gymnasium_records_an_episode(tmp_path):
    env = gymnasium.make("dcgrid/Toy6-v0", render_mode="rgb_array", horizon=2)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path / "videos"), disable_logger=True)
    env.reset(seed=0)
    over = False
    while not over:
        *_, over, _ = env.step(env.action_space.sample())
    env.close()
    (video,) = (tmp_path / "videos").glob("*.mp4")
    with importlib.import_module("moviepy").VideoFileClip(str(video)) as clip:
        assert tuple(clip.size) == (1360, 800)
        assert clip.n_frames == 3
        assert clip.fps == env.metadata["render_fps"]
        assert clip.get_frame(0.0).std() > 5.0
