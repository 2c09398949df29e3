"""The one-line diagram of a feeder: where its buses go, and drawing it on any matplotlib Axes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from numpy.typing import ArrayLike, NDArray

from dcgrid_env.feeder import Feeder

FloatArray = NDArray[np.float64]

# Okabe and Ito's colours less yellow: told apart under the common kinds of colour blindness, legible on white.
AGENT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
VOLTAGE_CMAP = "RdBu_r"
INK = "#333333"
_WIDTH_TO_HEIGHT = 1.35
_DC_RADIUS_PT = 8.5
_MANY_BUSES = 40


def voltage_norm(band_pu: float = 0.05) -> Normalize:
    """Colour scale of voltages in p.u.: 1.0 in the middle, half as far again as the band to either side."""
    reach = 1.5 * (band_pu or 0.05)
    return Normalize(1.0 - reach, 1.0 + reach)


def agent_colour(i: int) -> str:
    """Colour of data centre ``i``; they repeat after seven."""
    return AGENT_COLOURS[i % len(AGENT_COLOURS)]


def positions(feeder: Feeder) -> FloatArray:
    """Where each bus goes in a drawing, shape (n_bus, 2); distinct, finite and the same at each call.

    The published coordinates where the feeder has them. A bus without, or on top of another, goes beside the bus that
    it hangs on. Where fewer than half are known: a tree that grows to the right from the substation, the longest path
    straight, laterals to either side of it and no branch across another.
    """
    xy = np.column_stack((feeder.x, feeder.y))
    xy[~np.isfinite(xy).all(axis=1)] = np.nan
    _, first = np.unique(xy, axis=0, return_index=True)
    xy[np.setdiff1d(np.arange(feeder.n_bus), first)] = np.nan
    known = np.isfinite(xy[:, 0])
    if 2 * known.sum() < feeder.n_bus or known.sum() < 2:
        return _tree(feeder)
    return xy if known.all() else _beside(feeder, xy)


def _beside(feeder: Feeder, xy: FloatArray) -> FloatArray:
    """Fill in missing rows near a neighbour that is placed, in the direction with the most room."""
    upstream = np.concatenate(([-1], feeder.parent))
    lengths = np.linalg.norm(xy[1:] - xy[feeder.parent], axis=1)
    reach = 0.5 * np.nanmedian(lengths) if np.isfinite(lengths).any() else 0.02 * np.nanmax(np.ptp(xy, axis=0))
    angle = 2.0 * np.pi * np.arange(16) / 16
    around = reach * np.column_stack((np.cos(angle), np.sin(angle)))
    while not np.isfinite(xy).all():
        for i in feeder.depth_first:
            near = [upstream[i], *(np.flatnonzero(feeder.parent == i) + 1)]
            near = [j for j in near if j >= 0 and np.isfinite(xy[j, 0])]
            if np.isfinite(xy[i, 0]) or not near:
                continue
            candidates = xy[near[0]] + around
            placed = xy[np.isfinite(xy[:, 0])]
            room = np.linalg.norm(candidates[:, None] - placed, axis=2).min(axis=1)
            xy[i] = candidates[np.argmax(np.round(room / reach, 6))]
    return xy


class _Block:
    """A path of buses on one row with its laterals above and below; rows relative to it, columns absolute."""

    def __init__(self, chain: list[int], column: int, n_columns: int):
        self.at = {bus: (column + k, 0) for k, bus in enumerate(chain)}
        self.low = np.full(n_columns, np.inf)
        self.high = np.full(n_columns, -np.inf)
        # One column more than the path has, so that paths on the same row do not read as one.
        span = slice(column, column + len(chain) + 1)
        self.low[span] = self.high[span] = 0

    def attach(self, lateral: _Block, side: int | None) -> int:
        """Put a lateral as near as it goes, above (side 1) or below (-1), or where the block stays flatter."""
        up = max(1.0, float((self.high - lateral.low).max()) + 1.0)
        down = max(1.0, float((lateral.high - self.low).max()) + 1.0)
        if side is None:
            side = 1 if up + lateral.high.max() <= down - lateral.low.min() else -1
        shift = int(up) if side > 0 else -int(down)
        self.at |= {bus: (column, row + shift) for bus, (column, row) in lateral.at.items()}
        self.low = np.minimum(self.low, lateral.low + shift)
        self.high = np.maximum(self.high, lateral.high + shift)
        return side


def _tree(feeder: Feeder) -> FloatArray:
    children: list[list[int]] = [[] for _ in range(feeder.n_bus)]
    weight = [(1, 1)] * feeder.n_bus  # buses on the longest way down, buses in all
    for j in feeder.depth_first[::-1].tolist():
        below = [weight[k] for k in children[j]]
        weight[j] = (1 + max((b[0] for b in below), default=0), 1 + sum(b[1] for b in below))
        if j > 0:
            children[feeder.parent[j - 1]].append(j)

    def block(start: int, column: int) -> _Block:
        chain = [start]
        while children[chain[-1]]:
            chain.append(max(children[chain[-1]], key=lambda k: (weight[k], -k)))
        result = _Block(chain, column, 2 * feeder.n_bus + 1)
        # From the far end back: a lateral nearer to the root then passes outside those beyond it.
        for k in range(len(chain) - 1, -1, -1):
            laterals = sorted((b for b in children[chain[k]] if b not in chain), key=lambda b: (weight[b], b))
            # One lateral can rise straight from the bus on either side, any more lean to the right beneath them.
            for bus in laterals[:-2]:
                result.attach(block(bus, column + k + 1), None)
            side = None
            for bus in laterals[-2:]:
                side = result.attach(block(bus, column + k), None if side is None else -side)
        return result

    at = block(0, 0).at
    xy = np.array([at[i] for i in range(feeder.n_bus)], dtype=np.float64)
    width, height = np.maximum(np.ptp(xy, axis=0), 1.0)
    xy[:, 1] *= np.clip(width / height / _WIDTH_TO_HEIGHT, 0.3, 3.0)
    return xy


class FeederMap:
    """A feeder drawn on an Axes; ``place`` moves the devices and ``update`` the voltages without redrawing the rest.

    See :func:`draw_feeder`.
    """

    def __init__(self, ax: Axes, feeder: Feeder, xy: FloatArray, band_pu: float, n_dc: int, n_inv: int):
        self.ax, self.feeder, self.xy, self.band_pu = ax, feeder, xy, band_pu
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_axis_off()
        margin = 0.06 * np.ptp(xy, axis=0).max()
        ax.set_xlim(xy[:, 0].min() - margin, xy[:, 0].max() + margin)
        ax.set_ylim(xy[:, 1].min() - margin, xy[:, 1].max() + margin)
        self._draw_network()
        self._draw_devices(n_dc, n_inv)

    def _draw_network(self) -> None:
        ax, feeder, xy = self.ax, self.feeder, self.xy
        share = feeder.path.T @ feeder.p_load_kw
        width = 0.8 + 2.4 * np.sqrt(share / (share.max() or 1.0))
        segments = np.stack((xy[feeder.parent], xy[1:]), axis=1)
        ax.add_collection(LineCollection(list(segments), colors="#9A9A9A", linewidths=width.tolist(), zorder=1))
        few = feeder.n_bus <= _MANY_BUSES
        colour = {"cmap": VOLTAGE_CMAP, "norm": voltage_norm(self.band_pu), "edgecolors": INK, "linewidths": 0.6}
        ones = np.ones(feeder.n_bus)
        self.dots = ax.scatter(xy[1:, 0], xy[1:, 1], s=42 if few else 24, c=ones[1:], zorder=4, **colour)
        self.substation = ax.scatter(xy[:1, 0], xy[:1, 1], s=90, marker="s", c=ones[:1], zorder=4, **colour)
        self.rings = ax.scatter([], [], s=130 if few else 85, facecolors="none", edgecolors="black", linewidths=1.5)
        self.rings.set_zorder(6)
        self.triangles = ax.scatter([], [], s=75, marker="^", c=[], zorder=5, **colour)

    def _draw_devices(self, n_dc: int, n_inv: int) -> None:
        ax = self.ax
        self.halos = ax.scatter([], [], alpha=0.3, linewidths=0, zorder=2)
        self.halos.set_facecolor([agent_colour(i) for i in range(n_dc)])
        track = {"marker": "o", "linestyle": "none", "markersize": 2 * _DC_RADIUS_PT, "zorder": 3}
        (self.tracks,) = ax.plot([], [], **track, markerfacecolor="white", markeredgecolor="#C8C8C8", markeredgewidth=3)
        self.clocks: list[Line2D] = []
        self.labels: list[Annotation] = []
        for i in range(n_dc):
            (clock,) = ax.plot([], [], **track, markerfacecolor="none", markeredgewidth=3)
            clock.set_markeredgecolor(agent_colour(i))
            self.clocks.append(clock)
            self.labels.append(self._label(f"dc_{i}", 10, agent_colour(i), "bold"))
        self.labels += [self._label(f"inv_{i}", 8, "#555555", "normal") for i in range(n_inv)]

    def _label(self, text: str, size: float, colour: str, weight: str) -> Annotation:
        label = self.ax.annotate(text, (0.0, 0.0), (0.0, 0.0), textcoords="offset points", ha="center", va="center")
        label.set(fontsize=size, color=colour, fontweight=weight, zorder=7)
        label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
        return label

    def place(self, dc_buses: ArrayLike, inv_buses: ArrayLike) -> None:
        """Move the devices to these positions in ``bus_ids``, (n_dc,) and (n_inv,), and find room for their names."""
        self.dc = np.asarray(dc_buses, dtype=np.intp)
        self.inv = np.asarray(inv_buses, dtype=np.intp)
        at = self.xy[self.dc]
        self.halos.set_offsets(at)
        self.halos.set_sizes(np.zeros(len(at)))
        self.tracks.set_data(at[:, 0], at[:, 1])
        for clock, (x, y) in zip(self.clocks, at, strict=True):
            clock.set_data([x], [y])
        self.triangles.set_offsets(self.xy[self.inv])
        hidden = np.isin(np.arange(1, self.feeder.n_bus), self.inv)
        self.dots.set_linewidths(np.where(hidden, 0.0, 0.6).tolist())
        self._place_labels()

    def _place_labels(self) -> None:
        self.ax.apply_aspect()
        points_per_pixel = 72.0 / self.ax.figure.dpi
        to_points = lambda xy: self.ax.transData.transform(xy) * points_per_pixel  # noqa: E731
        bus = to_points(self.xy)
        along = np.linspace(0.0, 1.0, 25)[:, None, None]
        lines = (bus[self.feeder.parent] * (1 - along) + bus[1:] * along).reshape(-1, 2)
        devices = np.concatenate((self.dc, self.inv))
        radius = np.where(np.arange(len(devices)) < len(self.dc), _DC_RADIUS_PT + 2.0, 5.0)
        frame = self.ax.get_window_extent().get_points() * points_per_pixel
        taken: list[tuple[FloatArray, FloatArray]] = [
            (bus[i], np.array([r, r])) for i, r in zip(devices, radius, strict=True)
        ]
        angles = 2.0 * np.pi * (np.arange(16) / 16 + 0.25)
        for label, i, r in zip(self.labels, devices, radius, strict=True):
            size = label.get_fontsize()
            half = np.array([0.33 * size * len(label.get_text()), 0.55 * size])
            best, least = np.zeros(2), np.inf
            for reach, angle in ((reach, a) for reach in (1.0, 6.0, 14.0) for a in angles):
                way = np.array([np.cos(angle), np.sin(angle)])
                offset = way * (r + reach + np.minimum(half, np.abs(half @ np.abs(way))))
                centre = bus[i] + offset
                crowd = 0.4 * np.all(np.abs(lines - centre) < half + 1.0, axis=1).sum()
                crowd += 4.0 * np.all(np.abs(bus - centre) < half + 3.0, axis=1).sum()
                crowd += 40.0 * sum(bool(np.all(np.abs(c - centre) < h + half)) for c, h in taken)
                crowd += 40.0 * bool(np.any(centre - half < frame[0]) or np.any(centre + half > frame[1]))
                crowd += 0.1 * reach
                if crowd < least:
                    best, least = offset, crowd
            label.xy = tuple(self.xy[i])
            label.set_position(tuple(best))
            taken.append((bus[i] + best, half))

    def outside(self, v_pu: FloatArray) -> NDArray[np.bool_]:
        """Which voltages, p.u., are outside the band; one held exactly at the limit, give or take rounding, is not."""
        return np.abs(v_pu - 1.0) > self.band_pu + 1e-6

    def update(self, v_pu: ArrayLike, clock_share: ArrayLike | None = None, backlog_s: ArrayLike | None = None) -> None:
        """Show voltages, p.u., (n_bus,); clocks as shares of the largest and backlogs in s at the rating, (n_dc,)."""
        v = np.asarray(v_pu, dtype=np.float64)
        self.dots.set_array(v[1:])
        self.substation.set_array(v[:1])
        self.triangles.set_array(v[self.inv])
        self.rings.set_offsets(self.xy[self.outside(v)])
        for i, clock in enumerate(self.clocks):
            share = 1.0 if clock_share is None else float(np.asarray(clock_share)[i])
            # Clockwise from twelve o'clock. A marker is scaled by its farthest vertex, here always on the unit circle.
            angle = np.linspace(0.0, 2.0 * np.pi * min(max(share, 0.0), 1.0), 49)
            clock.set_marker(Path(np.column_stack((np.sin(angle), np.cos(angle)))))
        if backlog_s is not None:
            self.halos.set_sizes(300.0 * np.minimum(np.asarray(backlog_s, dtype=np.float64), 30.0))


def draw_feeder(
    ax: Axes,
    feeder: Feeder,
    xy: FloatArray,
    v_pu: ArrayLike,
    dc_buses: Sequence[int] | NDArray[np.intp],
    inv_buses: Sequence[int] | NDArray[np.intp] = (),
    *,
    band_pu: float = 0.05,
    clock_share: ArrayLike | None = None,
    backlog_s: ArrayLike | None = None,
) -> FeederMap:
    """Draw a feeder's one-line diagram, coloured by voltage, on an Axes of any figure.

    Branches are lines whose width grows with the load behind them, buses dots, the substation a square, inverters
    triangles, data centres large circles: the coloured arc around one is its clock, the halo its backlog.
    A bus outside the band is ringed in black.

    Parameters
    ----------
    ax
        Its axis lines are switched off and its aspect set to equal. Its place in the figure should be final, as the
        names of the devices are put where there is room.
    feeder, xy
        The feeder and the positions of its buses, (n_bus, 2), see :func:`positions`.
    v_pu
        Voltage at each bus, p.u., (n_bus,).
    dc_buses, inv_buses
        Positions in ``feeder.bus_ids`` of the data centres and inverters, (n_dc,) and (n_inv,).
    band_pu
        Half-width of the allowed band around 1 p.u.
    clock_share, backlog_s
        Clock as a share of the largest, and backlog in s at rated power, (n_dc,); a full arc and no halo if not given.

    Returns
    -------
    FeederMap
        Holds the artists. ``update`` shows other voltages, ``place`` moves the devices; ``dots`` serves for a colour bar.
    """
    drawn = FeederMap(ax, feeder, xy, band_pu, len(dc_buses), len(inv_buses))
    drawn.place(dc_buses, inv_buses)
    drawn.update(v_pu, clock_share, backlog_s)
    return drawn
