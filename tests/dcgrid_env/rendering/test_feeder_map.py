"""The feeder map: its colours, and how it is drawn on the Axes of any figure."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dcgrid_env import load_feeder
from dcgrid_env.rendering.bus_positions import positions
from dcgrid_env.rendering.feeder_map import draw_feeder, voltage_norm
from helpers.feeders import BALANCED


def test_the_colour_scale_is_centred_at_one_and_reaches_beyond_the_band():
    assert voltage_norm(0.05)(1.0) == pytest.approx(0.5)
    assert [float(voltage_norm(0.03)(v)) for v in (0.97, 1.03)] == pytest.approx([1 / 6, 5 / 6])
    assert voltage_norm(0.0)(1.0) == pytest.approx(0.5)


@pytest.fixture
def axes():
    figure = Figure((7, 5))
    FigureCanvasAgg(figure)
    return figure.add_axes((0.0, 0.0, 1.0, 1.0))


def boxes(drawn):
    renderer = drawn.ax.figure.canvas.get_renderer()
    return {t.get_text(): t.get_window_extent(renderer) for t in drawn.ax.texts if t.get_visible()}


@pytest.mark.parametrize("name", BALANCED)
def test_names_stay_in_the_frame_and_off_each_other(axes, name):
    feeder = load_feeder(name)
    buses = np.random.default_rng(1).permutation(np.arange(1, feeder.n_bus))[:10]
    drawn = draw_feeder(axes, feeder, positions(feeder), np.ones(feeder.n_bus), buses[:3], buses[3:])
    axes.figure.canvas.draw()
    written = boxes(drawn)
    for i in range(3):
        assert any(text.startswith(f"dc_{i}") for text in written)
    frame = axes.get_window_extent()
    items = list(written.items())
    for k, (text, box) in enumerate(items):
        assert frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1, text  # noqa: PT018
        for other, taken in items[:k]:
            assert not (box.shrunk(0.9, 0.7).overlaps(taken.shrunk(0.9, 0.7))), (text, other)


def test_what_the_artists_show(axes):
    feeder = load_feeder("ieee33")
    xy = positions(feeder)
    v = np.linspace(1.05, 0.93, 33)
    drawn = draw_feeder(axes, feeder, xy, v, [17, 32], [6], clock_share=[1.0, 0.25], backlog_s=[0.0, 3.0])
    np.testing.assert_array_equal(drawn.dots.get_array(), v[1:])
    np.testing.assert_array_equal(drawn.rings.get_offsets(), xy[v < 0.95])
    np.testing.assert_array_equal(drawn.triangles.get_offsets(), xy[[6]])
    full, quarter = (np.asarray(path.vertices) for path in drawn.clocks.get_paths())
    np.testing.assert_array_equal(drawn.clocks.get_offsets(), xy[[17, 32]])
    np.testing.assert_allclose(full[[0, -1]], [[0, 1], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(
        quarter[[0, -1]], [[0, 1], [1, 0]], atol=1e-12
    )  # clockwise from the top to three o'clock
    none, some = drawn.halos.get_sizes()
    assert none == 0.0
    assert some > 0.0

    drawn.place([3, 4], [5])
    drawn.update(np.ones(33))
    np.testing.assert_array_equal(drawn.tracks.get_xydata(), xy[[3, 4]])
    np.testing.assert_array_equal(drawn.triangles.get_offsets(), xy[[5]])
    assert np.size(drawn.rings.get_offsets()) == 0
    assert {"dc_0 (4)", "dc_1 (5)", "inv_0 (6)"} <= set(boxes(drawn))


def test_a_substation_held_at_the_limit_is_not_ringed(axes):
    feeder = load_feeder("toy6")
    v = np.array([1.05, 1.0, 1.0, 0.95, 0.9499, 1.0501])
    drawn = draw_feeder(axes, feeder, positions(feeder), v, [4])
    np.testing.assert_array_equal(drawn.outside(v), [False, False, False, False, True, True])
    np.testing.assert_array_equal(drawn.outside(v.astype(np.float32)), [False, False, False, False, True, True])
