"""The one-line diagram of a feeder, drawn on any matplotlib Axes; ``bus_positions`` says where its buses go."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from matplotlib.transforms import Affine2D
from numpy.typing import ArrayLike, NDArray

from dcgrid_env.grid import AnyFeeder, Feeder

FloatArray = NDArray[np.float64]

# Okabe and Ito's colours less yellow: told apart under the common kinds of colour blindness, legible on white.
AGENT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
VOLTAGE_CMAP = "RdBu_r"
INK = "#333333"
"""Colour of text and outlines."""
_MARGIN_PT = 28.0
_FEW_BUSES = 40
"""Feeders up to this size have their bus numbers written on the map."""
_ARC = np.linspace(0.0, 1.0, 49)
_WAYS = np.array([(np.cos(turn), np.sin(turn)) for turn in 2.0 * np.pi * (np.arange(16) / 16 + 0.25)])
"""Directions of a name from its bus."""
_REACHES = (1.0, 6.0, 14.0)
"""Distances of a name from the rim of its bus, points."""
_LED_REACHES = (9.0, 15.0, 22.0, 30.0, 40.0, 55.0, 75.0, 100.0)
"""Distances of a name with a line to its bus, points; all are outside the ring of the largest unbalance."""
_HALO_S, _HALO_AREA = 30.0, 3600.0
"""Backlog in s of rated power at which the halo is largest, and its area then, square points."""


def voltage_norm(band_pu: float = 0.05) -> Normalize:
    """Colour scale of voltages in p.u.: 1.0 in the middle, half as far again as the band to either side."""
    reach = 1.5 * (band_pu or 0.05)
    return Normalize(1.0 - reach, 1.0 + reach)


def agent_colour(i: int) -> str:
    """Colour of data centre ``i``; they repeat after seven."""
    return AGENT_COLOURS[i % len(AGENT_COLOURS)]


class FeederMap:
    """A feeder drawn on an Axes; ``place`` moves the devices and ``update`` the voltages without redrawing the rest.

    See :func:`draw_feeder`; ``names`` are those of the data centres and of the other devices.
    """

    avoids_own_bus = False
    """Whether a name next to its bus avoids the whole box of that bus, not only its centre."""

    def __init__(
        self, ax: Axes, feeder: AnyFeeder, xy: FloatArray, band_pu: float, names: tuple[Sequence[str], Sequence[str]]
    ):
        self.ax, self.feeder, self.xy, self.band_pu = ax, feeder, xy, band_pu
        few = feeder.n_bus <= _FEW_BUSES
        self._bus_area, self._dc_radius_pt = (42.0, 8.5) if few else (24.0, 7.5)
        self._frame_axes()
        self._draw_network(few)
        self._draw_devices(*names)

    @property
    def moving(self) -> list[Artist]:
        """What ``update`` changes, in drawing order; ``place`` also moves the names."""
        return [self.halos, self.tracks, self.clocks, self.dots, self.substation, self.triangles, self.rings]

    def _frame_axes(self) -> None:
        """Limits that fill the box at equal scales, with room for what reaches beyond a bus."""
        ax, (low, high) = self.ax, (self.xy.min(axis=0), self.xy.max(axis=0))
        box = ax.get_window_extent().get_points() * 72.0 / ax.figure.dpi
        size_pt = box[1] - box[0]
        scale = float(np.max((high - low) / (size_pt - 2 * _MARGIN_PT)))
        half = 0.5 * size_pt * scale
        middle = 0.5 * (low + high)
        ax.set_xlim(middle[0] - half[0], middle[0] + half[0])
        ax.set_ylim(middle[1] - half[1], middle[1] + half[1])
        ax.set_aspect("equal", adjustable="box")
        ax.set_axis_off()

    def _draw_network(self, few: bool) -> None:
        ax, feeder, xy = self.ax, self.feeder, self.xy
        share = fed_through(feeder)
        width = 0.8 + 2.4 * np.sqrt(share / (share.max() or 1.0))
        ends = xy[np.column_stack((feeder.parent, np.arange(1, feeder.n_bus)))]
        ax.add_collection(LineCollection(list(ends), colors="#9A9A9A", linewidths=width.tolist(), zorder=1))
        if isinstance(feeder, Feeder) and feeder.loop_ends is not None:
            ax.add_collection(LineCollection(list(xy[feeder.loop_ends]), colors="#9A9A9A", linewidths=0.8, zorder=1))
        self._draw_buses()
        self._ids = [self._label(str(bus), 7, "#777777", "normal") for bus in feeder.bus_ids] if few else []

    def _draw_buses(self) -> None:
        ax, feeder, xy = self.ax, self.feeder, self.xy
        look = {"cmap": VOLTAGE_CMAP, "norm": voltage_norm(self.band_pu), "edgecolors": INK, "linewidths": 0.6}
        ones = np.ones(feeder.n_bus)
        self.dots = ax.scatter(xy[1:, 0], xy[1:, 1], s=self._bus_area, c=ones[1:], zorder=4, **look)
        self.substation = ax.scatter(xy[:1, 0], xy[:1, 1], s=90, marker="s", c=ones[:1], zorder=4, **look)
        self.triangles = ax.scatter([], [], s=75, marker="^", c=[], zorder=5, **look)
        self.rings = ax.scatter([], [], facecolors="none", edgecolors="black", linewidths=1.6, zorder=6)

    def _draw_devices(self, sites: Sequence[str], others: Sequence[str]) -> None:
        ax, colours = self.ax, [agent_colour(i) for i in range(len(sites))]
        self.halos = ax.scatter([], [], alpha=0.3, linewidths=0, zorder=2, clip_on=False)
        self.halos.set_facecolor(colours)
        look = {"marker": "o", "linestyle": "none", "markersize": 2 * self._dc_radius_pt, "markeredgewidth": 3.0}
        (self.tracks,) = ax.plot([], [], **look, markerfacecolor="white", markeredgecolor="#C8C8C8", zorder=3)
        # Arcs of the unit circle, in points around the buses.
        self.clocks = LineCollection([], linewidths=3.0, colors=colours, zorder=3.5)
        self.clocks.set_transform(Affine2D().scale(self._dc_radius_pt / 72.0) + ax.figure.dpi_scale_trans)
        self.clocks.set_offset_transform(ax.transData)
        ax.add_collection(self.clocks, autolim=False)
        self._names = {name: self._label("", 10, colours[i], "bold") for i, name in enumerate(sites)}
        self._names |= {name: self._label("", 8, "#555555", "normal") for name in others}

    def _label(self, text: str, size: float, colour: str, weight: str) -> Annotation:
        label = self.ax.annotate(text, (0.0, 0.0), (0.0, 0.0), textcoords="offset points", ha="center", va="center")
        label.set(fontsize=size, color=colour, fontweight=weight, zorder=7)
        label.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
        return label

    def place(self, dc_buses: ArrayLike, other_buses: ArrayLike) -> None:
        """Move the devices to these positions in ``bus_ids``, (n_dc,) and (n_other,), and find room for their names."""
        self.dc = np.asarray(dc_buses, dtype=np.intp)
        self.others = np.asarray(other_buses, dtype=np.intp)
        site_xy = self.xy[self.dc]
        self.halos.set_offsets(site_xy)
        self.halos.set_sizes(np.zeros(len(site_xy)))
        self.tracks.set_data(site_xy[:, 0], site_xy[:, 1])
        self.clocks.set_offsets(site_xy)
        self.triangles.set_offsets(self.xy[self.others])
        self._size_buses()
        self._place_labels()

    def _size_buses(self) -> None:
        areas = np.full(self.feeder.n_bus, self._bus_area)
        areas[self.others] = 0.0  # the triangle stands in its place
        self.dots.set_sizes(areas[1:])
        self._ring_areas = np.where(areas > 0.0, 2.2 * self._bus_area, 190.0)
        self._ring_areas[0] = 260.0

    def _place_labels(self) -> None:
        to_points = 72.0 / self.ax.figure.dpi
        bus = self.ax.transData.transform(self.xy) * to_points
        radius = np.sqrt(self._ring_areas / np.pi) + 1.0
        radius[self.dc] = self._dc_radius_pt + 2.0
        frame = self.ax.get_window_extent().get_points() * to_points
        room = Room(bus, radius, self.feeder.parent, frame, self.avoids_own_bus)
        devices = [*self.dc, *self.others]
        for (name, label), i in zip(self._names.items(), devices, strict=True):
            label.set_text(f"{name} ({self.feeder.bus_ids[i]})" if self._ids else name)
            self._write(label, i, room)
        self._place_more(room)
        for i, label in enumerate(self._ids):
            label.set_visible(i not in devices)
            if label.get_visible():
                self._write(label, i, room)

    def _place_more(self, room: Room) -> None:
        """Find room for further names, after those of the devices and before those of the buses."""

    def _write(self, label: Annotation, i: int, room: Room) -> None:
        label.xy = tuple(self.xy[i])
        label.set_position(tuple(room.take(i, len(label.get_text()), float(label.get_fontsize()))))

    def outside(self, v_pu: ArrayLike) -> NDArray[np.bool_]:
        """Which voltages, p.u., are outside the band; one held exactly at the limit, give or take rounding, is not."""
        return np.abs(np.asarray(v_pu) - 1.0) > self.band_pu + 1e-6

    def update(
        self,
        v_pu: ArrayLike,
        clock_share: ArrayLike | None = None,
        backlog_s: ArrayLike | None = None,
    ) -> None:
        """Show voltages, p.u., (n_bus,); clocks as shares of the largest and backlogs in s at the rating, (n_dc,)."""
        self._show_voltages(np.asarray(v_pu, dtype=np.float64))
        share = np.clip(np.ones(len(self.dc)) if clock_share is None else np.asarray(clock_share, np.float64), 0.0, 1.0)
        angle = 2.0 * np.pi * share[:, None] * _ARC  # clockwise from twelve o'clock
        self.clocks.set_segments(list(np.stack((np.sin(angle), np.cos(angle)), axis=-1)))
        if backlog_s is not None:
            waiting = np.minimum(np.asarray(backlog_s, dtype=np.float64), _HALO_S)
            self.halos.set_sizes(_HALO_AREA * waiting / _HALO_S)

    def _show_voltages(self, v: FloatArray) -> None:
        self.dots.set_array(v[1:])
        self.substation.set_array(v[:1])
        self.triangles.set_array(v[self.others])
        outside = self.outside(v)
        self.rings.set_offsets(self.xy[outside])
        self.rings.set_sizes(self._ring_areas[outside])


class Room:
    """What is taken on a map, in points: buses, branches, the frame and the names placed so far."""

    def __init__(
        self, bus: FloatArray, radius: FloatArray, parent: NDArray[np.intp], frame: FloatArray, counts_own: bool
    ):
        self.bus, self.radius, self.frame, self.counts_own = bus, radius, frame, counts_own
        along = np.linspace(0.0, 1.0, 25)[:, None, None]
        self.lines = (bus[parent] * (1.0 - along) + bus[1:] * along).reshape(-1, 2)
        self.centres, self.halves = np.empty((0, 2)), np.empty((0, 2))

    def take(self, i: int, n_letters: int, size: float, n_lines: float = 1.0, led: bool = False) -> FloatArray:
        """Place a name next to bus ``i`` where it covers least; return the offset of its centre from the bus, (2,).

        A name that is ``led``, with a line to its bus, may be farther away, where the line crosses few names.
        """
        reaches = _LED_REACHES if led else _REACHES
        half = np.array([0.33 * size * n_letters, 0.5 * size * n_lines])
        ways = np.tile(_WAYS, (len(reaches), 1))
        reach = np.repeat(np.array(reaches), len(_WAYS))
        # As far out along each way as brings the name's box clear of the bus.
        clear = np.min(half / np.maximum(np.abs(ways), 1e-9), axis=1)
        offset = ways * (self.radius[i] + reach + clear)[:, None]
        centre = self.bus[i] + offset
        counted = self.counts_own | (np.arange(len(self.bus)) != i)
        farthest = np.abs(offset).max(axis=0) + half + 1.0
        lines = self.lines[np.all(np.abs(self.lines - self.bus[i]) < farthest, axis=1)]

        def covered(points: FloatArray, margin: ArrayLike) -> NDArray[np.intp]:
            return np.all(np.abs(points - centre[:, None]) < half + margin, axis=2).sum(axis=1)

        crowd = 0.1 * reach + 0.4 * covered(lines, 1.0)
        crowd += 20.0 * covered(self.bus[counted], self.radius[counted, None])
        crowd += 40.0 * covered(self.centres, self.halves)
        crowd += 40.0 * np.any((centre - half < self.frame[0]) | (centre + half > self.frame[1]), axis=1)
        if led:
            line = self.bus[i] + offset[:, None] * np.linspace(0.0, 1.0, 13)[1:, None]
            crosses = np.all(np.abs(line[:, :, None] - self.centres) < self.halves + 1.0, axis=3)
            crowd += 10.0 * crosses.sum(axis=(1, 2))
        best = int(np.argmin(crowd))
        self.centres = np.vstack((self.centres, centre[best]))
        self.halves = np.vstack((self.halves, half))
        return offset[best]


def draw_feeder(
    ax: Axes,
    feeder: AnyFeeder,
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

    Branches are lines whose width grows with the load behind them. Buses are dots, the substation is a square,
    inverters are triangles, and data centres are large circles. The coloured arc around a data centre shows its clock,
    and the halo its backlog. A bus outside the band has a black ring.

    Parameters
    ----------
    ax
        Its axis lines are switched off and its aspect set to equal. Its place in the figure should be final, as the
        names of the devices are put where there is room.
    feeder, xy
        The feeder and the positions of its buses, (n_bus, 2), see ``bus_positions.positions``.
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
        Its ``update`` shows other voltages, ``place`` moves the devices; ``dots`` serves for a colour bar.
    """
    names = [f"dc_{i}" for i in range(len(dc_buses))], [f"inv_{i}" for i in range(len(inv_buses))]
    drawn = FeederMap(ax, feeder, xy, band_pu, names)
    drawn.place(dc_buses, inv_buses)
    drawn.update(v_pu, clock_share, backlog_s)
    return drawn


def fed_through(feeder: AnyFeeder) -> np.ndarray:
    """Base load that each branch feeds, kW, (n_branch,)."""
    total = np.bincount(feeder.node_bus[feeder.leg_node], feeder.p_load_kw, feeder.n_bus)
    for bus in feeder.depth_first.order[:0:-1]:
        total[feeder.parent[bus - 1]] += total[bus]
    return total[1:]
