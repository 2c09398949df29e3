"""The picture of a running episode: the feeder's voltages on its map, next to the episode's curves."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.rendering.episode_curves import Curves
from dcgrid_env.rendering.feeder_map import INK
from dcgrid_env.rendering.history import History
from dcgrid_env.rendering.map_panel import MapPart, Panel
from dcgrid_env.rendering.phase_curves import PhaseCurves
from dcgrid_env.rendering.phase_panel import PhaseMapPart
from dcgrid_env.scenario.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.engine.simulation import Snapshot

_LOG = logging.getLogger(__name__)

SIZE_PX = (1360, 800)
_DPI = 100
# On top of matplotlib's defaults rather than the user's settings, so that a frame looks the same everywhere.
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.edgecolor": "#888888",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "xtick.color": "#888888",
    "ytick.color": "#888888",
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
}


class Viewer:
    """Draws the environments of a simulation, one at a time and all with one figure.

    Parameters
    ----------
    scenario
        What is simulated.
    render_mode
        "rgb_array" (``draw`` gives an image) or "human" (it shows a window, where the session has a display).
    n_env
        How many environments, the first ones, can be drawn.
    """

    def __init__(self, scenario: Scenario, render_mode: str, n_env: int = 1):
        self.scenario = scenario
        self.render_mode = render_mode
        self._histories = [History(scenario, env_index) for env_index in range(n_env)]
        self._forget()

    def record(self, snapshot: Snapshot) -> None:
        """Take a reset, a step or a restored snapshot in; cheap, nothing is drawn."""
        for history in self._histories:
            history.add(snapshot)

    def draw(self, env_index: int = 0) -> np.ndarray | None:
        """Draw an environment's episode up to now: an image, uint8, (height, width, 3), or None for "human".

        RuntimeError before the first episode.
        """
        return self.show(self._histories[env_index])

    def show(self, history: History) -> np.ndarray | None:
        """Draw a history, up to its last step, as ``draw`` does."""
        if history.last < 0:
            raise RuntimeError("nothing to draw yet; record a snapshot first")
        if self._figure is None:
            self._figure = self._make()
        if self._window is not None and not _is_open(self._window):
            return None
        changed = [part.update(history) for part in self._parts]
        canvas: Any = self._figure.canvas
        if self._window is not None:
            canvas.draw()
            canvas.flush_events()
            return None
        self._draw_still(canvas, [panel for panels in changed for panel in panels])
        for part in self._parts:
            for artist in part.moving:
                artist.draw(canvas.get_renderer())
        return None if self.render_mode == "human" else _rgb(canvas.buffer_rgba())

    def _draw_still(self, canvas: Any, changed: list[Panel]) -> None:
        """Bring back what seldom changes, axes, texts and legends: most of the work of a frame, drawn once and kept."""
        renderer = canvas.get_renderer()
        if self._still is None:
            changed = [panel for part in self._parts for panel in part.panels]
        else:
            canvas.restore_region(self._still)
        if not changed:
            return
        pixels = np.asarray(renderer.buffer_rgba())
        height, width = pixels.shape[:2]
        for panel in changed:
            left, bottom, right, top = panel.box
            rows = slice(round((1.0 - top) * height), round((1.0 - bottom) * height))
            pixels[rows, round(left * width) : round(right * width)] = 255
            for artist in panel.still:
                artist.draw(renderer)
        self._still = canvas.copy_from_bbox(canvas.figure.bbox)

    def close(self) -> None:
        """Close the window, if there is one, and forget the figure."""
        if self._window is not None:
            from matplotlib import pyplot

            pyplot.close(self._window)
        self._forget()

    def _forget(self) -> None:
        self._figure: Figure | None = None
        self._parts: tuple[MapPart | Curves, ...] = ()
        self._still: Any = None
        self._window: int | None = None

    def __getstate__(self) -> dict[str, Any]:
        # A copy draws a figure of its own: canvases and windows can be neither copied nor pickled.
        return self.__dict__ | {"_figure": None, "_parts": (), "_still": None, "_window": None}

    def _make(self) -> Figure:
        figure = self._new_figure()
        with matplotlib.rc_context():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(_STYLE)
            left, right = MapPart, Curves
            if isinstance(self.scenario.feeder, ThreePhaseFeeder):
                left, right = PhaseMapPart, PhaseCurves
            self._parts = (left(figure, self.scenario), right(figure, self.scenario))
        for artist in (artist for part in self._parts for artist in part.moving):
            artist.set_animated(self._window is None)  # left out of the still picture
        return figure

    def _new_figure(self) -> Figure:
        size = (SIZE_PX[0] / _DPI, SIZE_PX[1] / _DPI)
        if self.render_mode == "human":
            figure = _open_window(size)
            if figure is not None:
                self._window = figure.number  # pyright: ignore[reportAttributeAccessIssue]
                return figure
        figure = Figure(size, dpi=_DPI, facecolor="white")
        FigureCanvasAgg(figure)
        return figure


def _rgb(buffer: Any) -> np.ndarray:
    """A copy without the alpha channel; channel by channel, which is many times faster than all at once."""
    pixels = np.asarray(buffer)
    image = np.empty((*pixels.shape[:2], 3), np.uint8)
    for k in range(3):
        image[..., k] = pixels[..., k]
    return image


def _open_window(size: tuple[float, float]) -> Figure | None:
    """Return a pyplot figure with a window; log a message and return None if a window cannot be shown."""
    from matplotlib import pyplot
    from matplotlib.backend_bases import FigureManagerBase
    from matplotlib.backends.registry import backend_registry

    backend = matplotlib.get_backend()
    try:
        manager = backend_registry.load_backend_module(backend).FigureCanvas.manager_class
        # What a backend without windows has is the base class's show, which warns or does nothing.
        if manager.show is not FigureManagerBase.show:
            figure = pyplot.figure(figsize=size, dpi=_DPI, facecolor="white")
            figure.show()
            return figure
        reason = f"matplotlib's backend is {backend}"
    except Exception as error:  # each toolkit has errors of its own for a display that is not there
        reason = str(error)
    _LOG.warning("no window to show the environment in: %s; render_mode='rgb_array' gives images", reason)
    return None


def _is_open(number: int) -> bool:
    from matplotlib import pyplot

    return pyplot.fignum_exists(number)
