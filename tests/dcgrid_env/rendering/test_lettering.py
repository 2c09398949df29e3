"""Lettering looks like matplotlib's own text."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

from dcgrid_env.rendering.lettering import Lettering

WORDS = "ieee123   t = 75 of 120 s;   lowest voltage 0.9712 p.u. at bus 83, (gpqy)"
FONTS = {"bold": FontProperties(family="DejaVu Sans", size=13, weight="bold")}
FONTS["plain"] = FontProperties(family="DejaVu Sans", size=10)


def ink(dpi, add):
    """Darkness of each pixel of a figure of one line, 0 to 1."""
    figure = Figure((9.0, 0.6), dpi=dpi, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    artist = add(figure)
    canvas.draw()
    return 1.0 - np.asarray(canvas.buffer_rgba())[..., 0] / 255.0, canvas, artist


def lettering(font, text):
    def add(figure):
        made = Lettering(figure, (0.02, 0.5), font, "black")
        made.set_text(text)
        return made

    return add


@pytest.mark.parametrize("dpi", [72, 100, 200])
@pytest.mark.parametrize("font", FONTS)
def test_it_is_where_and_what_a_text_is(font, dpi):
    ours, _, artist = ink(dpi, lettering(FONTS[font], WORDS))
    style = {"fontproperties": FONTS[font], "va": "center", "color": "black"}
    text, *_ = ink(dpi, lambda figure: figure.text(0.02, 0.5, WORDS, **style))
    assert artist.get_text() == WORDS
    assert ours.sum() == pytest.approx(text.sum(), rel=0.02)
    for axis, off in ((0, 3.0), (1, 1.0)):  # px by which anything is shifted, along and across
        places = [np.flatnonzero(image.max(axis=axis) > 0.3)[[0, -1]] for image in (ours, text)]
        assert np.abs(places[0] - places[1]).max() <= off * max(dpi / 100, 1.0)


def test_another_text_leaves_nothing_of_the_last_and_each_part_is_drawn_once(monkeypatch):
    first, canvas, artist = ink(100, lettering(FONTS["plain"], "t = 10 s"))
    made = []
    plain = artist._drawn
    monkeypatch.setattr(artist, "_drawn", lambda part, renderer: made.append(part) or plain(part, renderer))
    for text in ("t = 25 s", "t = 52 s", "t = 10 s"):
        artist.set_text(text)
        canvas.draw()
    assert made == ["2", "5"]
    np.testing.assert_array_equal(1.0 - np.asarray(canvas.buffer_rgba())[..., 0] / 255.0, first)


def test_another_resolution_draws_the_parts_anew():
    _, canvas, _ = ink(72, lettering(FONTS["plain"], WORDS))
    canvas.figure.set_dpi(144)
    canvas.draw()
    finer, *_ = ink(144, lettering(FONTS["plain"], WORDS))
    np.testing.assert_array_equal(1.0 - np.asarray(canvas.buffer_rgba())[..., 0] / 255.0, finer)
