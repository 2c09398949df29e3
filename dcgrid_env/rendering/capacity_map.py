"""Maps of a feeder coloured by the size of what its buses carry, one for each way of controlling it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from dcgrid_env.grid import AnyFeeder
from dcgrid_env.rendering.bus_positions import positions
from dcgrid_env.rendering.feeder_map import INK, FeederMap

CMAP = "viridis"
NONE_COLOUR = "#D55E00"
"""Buses that carry nothing."""
NOT_ASKED = "#E6E6E6"
"""Buses that are not candidates."""
_WIDE_RANGE = 8.0
"""Ratio of the largest to the least size from which the scale is logarithmic."""
_PANEL_IN = (6.4, 4.8)
_SMALLER_FROM = 500
"""Number of buses from which the dots of buses that are not candidates become smaller."""
_MOST_LABELS = 40
"""Number of candidates up to which the size of each is written at its bus."""


class CapacityMap(FeederMap):
    """A feeder's one-line diagram coloured by MW.

    Parameters
    ----------
    ax, feeder, xy
        See ``feeder_map.draw_feeder``.
    capacity_mw
        Capacity of each bus, MW, (n_bus,); NaN for buses that are not candidates.
    norm
        The colour scale.
    """

    def __init__(
        self,
        ax: Axes,
        feeder: AnyFeeder,
        xy: NDArray[np.float64],
        capacity_mw: NDArray[np.float64],
        norm: Normalize,
    ):
        self._capacity_mw, self._norm = capacity_mw, norm
        super().__init__(ax, feeder, xy, 0.05, ((), ()))
        self.place((), ())

    def _draw_buses(self) -> None:
        super()._draw_buses()
        self.dots.remove()
        self.substation.remove()
        ax, xy, mw = self.ax, self.xy, self._capacity_mw
        colours = colormaps[CMAP](self._norm(np.where(mw > 0.0, mw, 1.0)))
        colours[mw <= 0.0] = _rgba(NONE_COLOUR)
        colours[np.isnan(mw)] = _rgba(NOT_ASKED)
        look = {"edgecolors": INK, "zorder": 4}
        is_asked = ~np.isnan(mw)
        order = 1 + np.argsort(is_asked[1:], kind="stable")  # candidates above the others
        areas = self._bus_area * np.where(is_asked, 1.6, min(1.0, _SMALLER_FROM / len(mw)))
        widths = np.where(is_asked, 0.6, 0.3)[order].tolist()
        self.dots = ax.scatter(*xy[order].T, s=areas[order], c=colours[order], linewidths=widths, **look)
        self.substation = ax.scatter(xy[:1, 0], xy[:1, 1], s=90, marker="s", c=[INK], **look)
        requested = np.flatnonzero(is_asked)
        for bus in requested if len(requested) <= _MOST_LABELS else ():
            text = f"{mw[bus]:.3g}"
            ax.annotate(
                text,
                xy[bus],
                (0, -6),
                textcoords="offset points",
                fontsize=7,
                color=INK,
                ha="center",
                va="top",
                zorder=5,
            )

    def _size_buses(self) -> None:
        self._ring_areas = np.full(self.feeder.n_bus, 2.2 * self._bus_area)


def capacity_figure(feeder: AnyFeeder, capacities_mw: Mapping[str, NDArray[np.float64]], title: str) -> Figure:
    """Draw a panel for each controller, all on one scale.

    Parameters
    ----------
    feeder
        The feeder.
    capacities_mw
        Capacity of each bus by controller, MW, (n_bus,); NaN for buses that are not candidates.
    title
        Title above all panels.

    Returns
    -------
    Figure
        Each panel's title has the controller and the median over its candidates.
    """
    n = len(capacities_mw)
    columns = min(n, 2)
    rows = -(-n // columns)
    figure = Figure(figsize=(columns * _PANEL_IN[0] + 1.2, rows * _PANEL_IN[1] + 0.9))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        rows, columns, left=0.01, right=1.0 - 1.15 / figure.get_figwidth(), top=1.0 - 0.75 / figure.get_figheight(),
        bottom=0.08 if rows == 1 else 0.05, wspace=0.02, hspace=0.12,
    )  # fmt: skip
    norm, xy = _norm(capacities_mw), positions(feeder)
    for i, (name, mw) in enumerate(capacities_mw.items()):
        ax = figure.add_subplot(grid[i // columns, i % columns])
        known_mw = mw[~np.isnan(mw)]
        ax.set_title(f"{name}: median {np.median(known_mw):.3g} MW, least {known_mw.min():.3g}", fontsize=11)
        CapacityMap(ax, feeder, xy, mw, norm)
    bar = figure.add_axes((1.0 - 1.0 / figure.get_figwidth(), 0.15, 0.2 / figure.get_figwidth(), 0.65))
    figure.colorbar(ScalarMappable(norm, CMAP), cax=bar, label="largest data centre (MW)", format="%g")
    if isinstance(norm, LogNorm):
        bar.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
    _explain(figure, capacities_mw)
    figure.suptitle(title, fontsize=12, y=1.0 - 0.12 / figure.get_figheight())
    return figure


def _norm(capacities_mw: Mapping[str, NDArray[np.float64]]) -> Normalize:
    """One scale for all, logarithmic where sizes are far apart."""
    every = np.concatenate([mw[mw > 0.0] for mw in capacities_mw.values()])
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.1, 1.0)
    if high >= _WIDE_RANGE * low:
        return LogNorm(low, high)
    return Normalize(0.0, high)


def _explain(figure: Figure, capacities_mw: Mapping[str, NDArray[np.float64]]) -> None:
    """A legend for the buses that have no colour of the scale, where there are any."""
    every = np.stack(list(capacities_mw.values()))[:, 1:]
    shown = [
        (colour, text)
        for colour, text, there in (
            (NONE_COLOUR, "carries no site", (every <= 0.0).any()),
            (NOT_ASKED, "no candidate", np.isnan(every).any()),
        )
        if there
    ]
    marks = [Line2D([], [], marker="o", linestyle="none", markerfacecolor=c, markeredgecolor=INK) for c, _ in shown]
    if marks:
        figure.legend(marks, [text for _, text in shown], loc="lower left", ncols=2, fontsize=9, frameon=False)


def _rgba(colour: str) -> tuple[float, ...]:
    return (*(int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)), 1.0)
