"""Figures without a window, named axes, and colours that differ under the common kinds of colour blindness."""

from __future__ import annotations

from typing import Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

REFERENCE_COLOUR, FRONT_COLOUR, REST_COLOUR = "#D55E00", "#0072B2", "#6b6b6b"
"""Colours of the reference, of controllers on the Pareto front, and of the rest."""


def new_figure(
    width_in: float, height_in: float, layout: Literal["constrained", "tight"] | None = "constrained"
) -> Figure:
    """Return a figure without a window; ``layout`` is Matplotlib's."""
    figure = Figure(figsize=(width_in, height_in), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def label_axes(ax: Axes, x: str, y: str, title: str = "") -> None:
    """Name the axes, with a light grid."""
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.set_title(title, fontsize=10.5)
    ax.grid(alpha=0.25, linewidth=0.6)
    ax.spines[["top", "right"]].set_visible(False)
