"""Films of episodes, gif and mp4: the frames of the viewer, under several controllers side by side."""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from dcgrid_env.core.files import require_folder, write_bytes
from dcgrid_env.core.suggestions import from_clone
from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.rendering.feeder_map import INK
from dcgrid_env.rendering.history import History
from dcgrid_env.rendering.viewer import SIZE_PX, Viewer

SUFFIXES = (".gif", ".mp4")
_STRIP_PX = 40
"""Height of the strip above a frame, with the controller's name."""
_SCALES = {".gif": 0.6, ".mp4": 1.0}
"""Size of a frame next to the viewer's: a gif of full size would be large."""


def require_imageio(path: Path) -> None:
    """Raise ValueError for a file that is not a film, or if the writer is not installed."""
    if path.suffix not in SUFFIXES:
        raise ValueError(f"{path}: a film's file ends in {' or '.join(SUFFIXES)}")
    for package in ("imageio", "imageio_ffmpeg")[: 2 if path.suffix == ".mp4" else 1]:
        try:
            importlib.import_module(package)
        except ImportError:
            raise ValueError(f"{path}: {package} writes it; install it, {from_clone('video')}") from None


def write_film(
    path: str | Path,
    runs: Mapping[str, Series],
    fps: float = 10.0,
    every: int = 1,
    on_frame: Callable[[], None] | None = None,
) -> Path:
    """Write a film of the same episode under one controller or several, each in a separate picture.

    Parameters
    ----------
    path
        Its file, which ends in .gif or .mp4; written whole or not at all.
    runs
        Episodes by the controllers' names.
    fps
        Frames a second.
    every
        Steps from one frame to the next.
    on_frame
        Called after each frame (for progress).

    Raises
    ------
    ValueError
        See :func:`require_imageio`.
    """
    path = Path(path)
    require_imageio(path)
    require_folder(path.parent)
    look: dict[str, Any] = {"macro_block_size": 2} if path.suffix == ".mp4" else {"loop": 0}
    # A gif's frames last whole hundredths of a second, which imageio takes as milliseconds.
    look |= {"fps": fps} if path.suffix == ".mp4" else {"duration": 10.0 * max(2, round(100.0 / fps))}
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / path.name
        with importlib.import_module("imageio.v2").get_writer(part, **look) as writer:
            for frame in frames(runs, every, _SCALES[path.suffix] / max(1.0, len(runs) ** 0.5)):
                writer.append_data(frame)
                if on_frame is not None:
                    on_frame()
        write_bytes(path, part.read_bytes())
    return path


def frames(runs: Mapping[str, Series], every: int = 1, scale: float = 1.0) -> Iterator[np.ndarray]:
    """Pictures of every so many steps, uint8, (height, width, 3); those of an episode that ends early stay."""
    from PIL import Image

    viewers = [Viewer(run.scenario, "rgb_array") for run in runs.values()]
    histories = [History.from_series(run) for run in runs.values()]
    ends = [history.last for history in histories]
    width, height = (2 * round(0.5 * scale * side) for side in (SIZE_PX[0], SIZE_PX[1] + _STRIP_PX))
    for step in [*range(0, max(ends), every), max(ends)]:
        pictures = []
        for (name, run), viewer, history, end in zip(runs.items(), viewers, histories, ends, strict=True):
            history.last = min(step, end)
            spent = run.cost_j[: history.last].sum() / run.scenario.horizon
            strip = _strip(f"{name}    J so far = {spent:.3f}")
            whole = Image.fromarray(np.vstack((strip, viewer.show(history))))  # pyright: ignore
            pictures.append(np.asarray(whole.resize((width, height), Image.Resampling.LANCZOS)))
        yield np.hstack(pictures)


def _strip(text: str) -> np.ndarray:
    from PIL import Image, ImageDraw, ImageFont

    strip = Image.new("RGB", (SIZE_PX[0], _STRIP_PX), "white")
    font = ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans-Bold.ttf"), 22)
    ImageDraw.Draw(strip).text((20, 8), text, fill=INK, font=font)
    return np.asarray(strip)
