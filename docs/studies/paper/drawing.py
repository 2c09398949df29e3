"""Common parts of the study's figures: colours, marks and names of axes."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes

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


def line(law: str) -> dict[str, Any]:
    """Look of a law's line over time: no marks."""
    return {key: value for key, value in LOOKS[law].items() if key != "marker"} | {"linewidth": 1.6}


def band(ax: Axes, band_pu: float = 0.05) -> None:
    """The limits of the band as thin dashed lines, and 1 p.u."""
    for edge in (1.0 - band_pu, 1.0 + band_pu):
        ax.axhline(edge, color="black", linestyle=(0, (4, 4)), linewidth=0.9)
    ax.axhline(1.0, color="black", linewidth=0.5, alpha=0.5)
