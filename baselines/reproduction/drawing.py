"""Common parts of the study's figures: colours, marks and names of axes."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

LABELS = {
    "none": "no control",
    "inverters": "inverters only",
    "reactive": "all reactive (k_p = 0)",
    "both": "both axes",
    "both-one-step": "both axes, printed one-step backlog",
}
# Okabe and Ito's colours, and marks and dashes that differ, so that grey shades serve too.
LOOKS: dict[str, dict[str, Any]] = {
    "none": {"color": "#000000", "linestyle": ":", "marker": "s"},
    "inverters": {"color": "#E69F00", "linestyle": "--", "marker": "^"},
    "reactive": {"color": "#009E73", "linestyle": "-.", "marker": "D"},
    "both": {"color": "#0072B2", "linestyle": "-", "marker": "o"},
    "both-one-step": {"color": "#D55E00", "linestyle": (0, (5, 1)), "marker": "v"},
}
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def new_figure(width_in: float, height_in: float) -> Figure:
    """A figure without a window."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def line(law: str) -> dict[str, Any]:
    """Look of a law's line over time: no marks."""
    return {key: value for key, value in LOOKS[law].items() if key != "marker"} | {"linewidth": 1.6}


def say(ax: Axes, x: str, y: str, title: str = "") -> None:
    """Name the axes, with a light grid."""
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.set_title(title, fontsize=10.5)
    ax.grid(alpha=0.25, linewidth=0.6)
    ax.spines[["top", "right"]].set_visible(False)


def band(ax: Axes, band_pu: float = 0.05) -> None:
    """The limits of the band as thin dashed lines, and 1 p.u."""
    for edge in (1.0 - band_pu, 1.0 + band_pu):
        ax.axhline(edge, color="black", linestyle=(0, (4, 4)), linewidth=0.9)
    ax.axhline(1.0, color="black", linewidth=0.5, alpha=0.5)
