"""Maps coloured by MW: one scale for all, and marks for what has no size."""

import io

import numpy as np
import pytest
from matplotlib.colors import LogNorm, Normalize, to_hex

from dcgrid_env import load_feeder
from dcgrid_env.rendering.bus_positions import positions
from dcgrid_env.rendering.capacity_map import NONE_COLOUR, NOT_ASKED, capacity_figure

FEEDER = load_feeder("ieee33")


def maps(low, high):
    mw = np.full(FEEDER.n_bus, np.nan)
    mw[1:] = np.linspace(high, low, FEEDER.n_bus - 1)
    return mw


def panels(figure):
    return [ax for ax in figure.axes if ax.get_title()]


@pytest.mark.slow
def test_a_panel_for_each_controller_on_one_scale():
    wide, narrow = maps(0.2, 20.0), maps(1.0, 2.0)
    figure = capacity_figure(FEEDER, {"none": wide, "droop": narrow, "mpc": wide}, "ieee33")
    assert [ax.get_title().split(":")[0] for ax in panels(figure)] == ["none", "droop", "mpc"]
    assert panels(figure)[1].get_title() == "droop: median 1.5 MW, least 1"
    (bar,) = [ax for ax in figure.axes if ax.get_ylabel() == "largest data centre (MW)"]
    assert bar.get_ylim() == pytest.approx((0.2, 20.0))
    figure.savefig(io.BytesIO(), dpi=50)


@pytest.mark.parametrize(("low", "kind"), [(0.2, LogNorm), (5.0, Normalize)])
def test_sizes_far_apart_are_on_a_logarithmic_scale(low, kind):
    figure = capacity_figure(FEEDER, {"none": maps(low, 20.0)}, "ieee33")
    (bar,) = [ax for ax in figure.axes if ax.get_ylabel() == "largest data centre (MW)"]
    assert bar.get_yscale() == ("log" if kind is LogNorm else "linear")


def test_buses_without_a_size_are_told_apart():
    mw = maps(1.0, 2.0)
    mw[5], mw[7] = 0.0, np.nan
    figure = capacity_figure(FEEDER, {"none": mw}, "ieee33")
    (dots,) = [c for c in panels(figure)[0].collections if len(c.get_facecolor()) == FEEDER.n_bus - 1]
    colours = [to_hex(colour).upper() for colour in np.asarray(dots.get_facecolor())]
    assert colours[0] == NOT_ASKED, "below the candidates"
    (without,) = np.flatnonzero([colour == NONE_COLOUR for colour in colours])
    assert np.asarray(dots.get_offsets())[without] == pytest.approx(positions(FEEDER)[5])
    assert NOT_ASKED not in colours[1:]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["carries no site", "no candidate"]
