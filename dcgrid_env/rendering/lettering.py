"""A line of text that changes from frame to frame, cheap to draw."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

_PARTS = re.compile(r"\d|\D+")  # digits stand alone, so that figures that count on make nothing new


class Lettering(Artist):
    """Text composed of images of its parts, each drawn once; a Text lays out and draws every letter each time.

    Parameters
    ----------
    figure
        The figure that contains the text.
    xy
        Left end and vertical centre, as shares of the figure.
    font, colour
        Font and colour of the text.
    """

    def __init__(self, figure: Figure, xy: tuple[float, float], font: FontProperties, colour: str):
        super().__init__()
        self.xy, self.font, self.colour = xy, font, colour
        self._text = ""
        self._dpi = self._rise = 0.0
        self._images: dict[str, tuple[np.ndarray, float, float]] = {}
        figure.add_artist(self)

    def get_text(self) -> str:
        """What is written."""
        return self._text

    def set_text(self, text: str) -> None:
        """Write something else."""
        if text != self._text:
            self._text, self.stale = text, True

    def draw(self, renderer: Any) -> None:
        """Draw it, on any renderer that takes images."""
        figure: Any = self.get_figure()
        if figure.dpi != self._dpi:  # a window may move to a finer screen
            self._dpi, self._images = figure.dpi, {}
            _, height, descent = renderer.get_text_width_height_descent("lp", self.font, False)
            self._rise = descent - 0.5 * height
        x, y = figure.transSubfigure.transform(self.xy)
        gc = renderer.new_gc()
        for part in _PARTS.findall(self._text):
            if part not in self._images:
                self._images[part] = self._drawn(part, renderer)
            image, below, advance = self._images[part]
            renderer.draw_image(gc, int(x + 0.5), int(y + self._rise - below + 0.5), image)
            x += advance
        gc.restore()
        self.stale = False

    def _drawn(self, part: str, renderer: Any) -> tuple[np.ndarray, float, float]:
        """Image of a part, how far it reaches below the line, and where the next begins, px."""

        def width(text: str) -> float:
            return renderer.get_text_width_height_descent(text, self.font, False)[0]

        _, height, descent = renderer.get_text_width_height_descent(part, self.font, False)
        below = int(np.ceil(descent)) + 1
        paper = RendererAgg(int(width(part)) + 4, int(np.ceil(height)) + 4, self._dpi)
        gc = paper.new_gc()
        gc.set_foreground((*to_rgb(self.colour), 1.0), isRGBA=True)
        paper.draw_text(gc, 0, paper.height - below, part, self.font, 0.0)
        # Spaces at the end have no width of their own: what follows tells where they end.
        return np.asarray(paper.buffer_rgba())[::-1].copy(), below, width(f"{part}0") - width("0")
