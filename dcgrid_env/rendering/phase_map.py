"""The one-line diagram of a three-phase feeder: each bus shows the voltage of every phase that it has."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.path import Path

from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.rendering.equipment_labels import EquipmentLabels
from dcgrid_env.rendering.feeder_map import INK, VOLTAGE_CMAP, FeederMap, FloatArray, Room, voltage_norm

PHASES = "abc"
FIRST_DEG = (30.0, -90.0, 150.0)
"""Where the sector of each phase begins, counterclockwise from three o'clock: a on top, b lower right, c lower left."""
WORST: dict[str, Any] = {"edgecolors": "#8E0152", "linestyles": [(0, (2.5, 1.5))], "linewidths": 2.0}
NO_VOLTAGE = "#BDBDBD"
"""Colour of a node without a voltage."""


def sector(phase: int) -> Path:
    """The sector of a circle in which a bus shows phase 0, 1 or 2."""
    return Path(np.vstack(((0.0, 0.0), _along(phase), (0.0, 0.0))), closed=True)


def rim(phase: int) -> Path:
    """The arc around that sector."""
    return Path(_along(phase))


def _along(phase: int) -> FloatArray:
    """Points of a sector's arc; few straight lines are drawn in half the time of curves."""
    angle = np.deg2rad(FIRST_DEG[phase] + np.linspace(0.0, 120.0, 9))
    return np.column_stack((np.cos(angle), np.sin(angle)))


class PhaseMap(FeederMap):
    """A three-phase feeder drawn on an Axes; ``update`` takes the voltage of every node, (n_node,).

    A bus is a circle of three sectors, coloured where it has the phase; a sector outside the band has a black rim.
    The substation is in a square, a device other than a data centre in a triangle, and the outlet of a regulator in a
    diamond. ``label_equipment`` adds the taps and the capacitor banks, ``mark_worst`` the ring of the unbalance.
    """

    avoids_own_bus = True
    feeder: ThreePhaseFeeder
    equipment: EquipmentLabels | None = None

    def _draw_buses(self) -> None:
        ax, feeder, xy = self.ax, self.feeder, self.xy
        few = self._bus_area > 30.0
        self._diameter_pt, self._dc_radius_pt = (11.0, 9.5) if few else (8.2, 8.0)
        frame: dict[str, Any] = {"facecolors": "white", "edgecolors": INK, "linewidths": 0.9, "zorder": 1.6}
        size = self._diameter_pt**2
        self.substation = ax.scatter(xy[:1, 0], xy[:1, 1], s=2.1 * size, marker="s", **frame)
        self.triangles = ax.scatter([], [], s=5.4 * size, marker=(3, 0, 0), **frame)
        self._outlets = sorted({feeder.index(bus) for bus in feeder.network.regulator.to_bus})
        self.diamonds = ax.scatter(*xy[self._outlets].reshape(-1, 2).T, s=2.4 * size, marker="D", **frame)
        cmap = matplotlib.colormaps[VOLTAGE_CMAP].with_extremes(bad=NO_VOLTAGE)
        look: dict[str, Any] = {"cmap": cmap, "norm": voltage_norm(self.band_pu), "plotnonfinite": True}
        look |= {"s": size, "edgecolors": INK, "linewidths": 0.5, "zorder": 4, "snap": False}
        lacks = xy[[len(phases) < 3 for phases in feeder.bus_phases]]
        empty: dict[str, Any] = {"facecolors": "white", "edgecolors": "#B0B0B0", "linewidths": 0.6}
        self.circles = ax.scatter(*lacks.T, s=size, zorder=1.7, **empty)
        self._phase_nodes = [np.flatnonzero(feeder.node_phase == phase + 1) for phase in range(3)]
        self._phase_xy = [xy[feeder.node_bus[nodes]] for nodes in self._phase_nodes]
        self.sectors = [
            ax.scatter(*xy.T, c=np.ones(len(xy)), marker=sector(phase), **look)
            for phase, xy in enumerate(self._phase_xy)
        ]
        self.dots = self.sectors[0]
        line: dict[str, Any] = {"facecolors": "none", "edgecolors": "black", "linewidths": 1.8, "zorder": 4.5}
        self.rims = [
            ax.scatter([], [], s=(self._diameter_pt + 1.8) ** 2, marker=rim(phase), **line) for phase in range(3)
        ]
        self.worst = ax.scatter([], [], facecolors="none", zorder=6, **WORST)

    @property
    def moving(self) -> list[Artist]:
        """What ``update`` and ``mark_worst`` change, in drawing order."""
        return [self.halos, self.tracks, self.clocks, *self.sectors, *self.rims, self.worst]

    def _size_buses(self) -> None:
        self._ring_areas = np.full(self.feeder.n_bus, np.pi * (0.5 * self._diameter_pt + 0.5) ** 2)
        self._ring_areas[self.others] *= 3.2
        self._ring_areas[self._outlets] *= 2.2
        self._ring_areas[0] *= 2.0
        self._worst_pt = np.full(self.feeder.n_bus, self._diameter_pt + 7.0)
        self._worst_pt[[*self.dc, *self.others, *self._outlets]] = 2.0 * self._dc_radius_pt + 7.0

    def label_equipment(self, equipment: EquipmentLabels) -> None:
        """Take the labels of regulators and capacitor banks in; ``place`` finds room for them."""
        self.equipment = equipment

    def _place_more(self, room: Room) -> None:
        if self.equipment is not None:
            self.equipment.place(self.xy, room, 0.5 * self._diameter_pt)

    def _show_voltages(self, v: FloatArray) -> None:
        outside = self.outside(v)
        for phase, (shown, beyond, xy) in enumerate(zip(self.sectors, self.rims, self._phase_xy, strict=True)):
            nodes = self._phase_nodes[phase]
            shown.set_array(np.ma.masked_invalid(v[nodes]))
            beyond.set_offsets(xy[outside[nodes]])
            beyond.set_visible(bool(outside[nodes].any()))

    def mark_worst(self, bus: int | None) -> None:
        """Ring the bus at a position in ``bus_ids``, or none; after ``place``."""
        self.worst.set_visible(bus is not None)
        if bus is not None:
            self.worst.set_offsets(self.xy[[bus]])
            self.worst.set_sizes(self._worst_pt[[bus]] ** 2)
