"""The left half of the picture, the feeder's map, and what the halves share."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.legend import Legend
from matplotlib.lines import Line2D

from dcgrid_env.devices.grid_equipment import is_equipment
from dcgrid_env.rendering.bus_positions import positions
from dcgrid_env.rendering.feeder_map import INK, FeederMap, agent_colour, voltage_norm
from dcgrid_env.rendering.history import History, node_words, sites_first
from dcgrid_env.rendering.lettering import Lettering
from dcgrid_env.scenario.scenario import Scenario

MIDDLE = 0.53
"""Where the halves meet, as a share of the width."""


class Panel(NamedTuple):
    """A rectangle of the picture whose content seldom changes and is redrawn as a whole."""

    box: tuple[float, float, float, float]
    """Left, bottom, right and top, as shares of the figure."""
    still: list[Artist]


class MapPart:
    """The left half: title, feeder, colour bar, and what the signs mean."""

    spacing = 1.2
    """Between the columns of signs, letters' sizes."""
    bottom = 0.0
    """How much higher the map and its colour bar end than where the signs take one line, a share of the height."""

    def __init__(self, figure: Figure, scenario: Scenario):
        self.scenario = scenario
        self.time_unit = time_unit(scenario)
        ax = figure.add_axes((0.01, 0.155 + self.bottom, 0.52, 0.735 - self.bottom))
        agents = [scenario.agents[i] for i in sites_first(scenario)]
        self.feeder = self._map(ax, (agents[: scenario.n_sites], agents[scenario.n_sites :]))
        self.buses: np.ndarray | None = None
        look: Any = {"family": "DejaVu Sans"}
        self.title = Lettering(figure, (0.015, 0.955), FontProperties(**look, size=13, weight="bold"), INK)
        self.subtitle = Lettering(figure, (0.015, 0.918), FontProperties(**look, size=10), INK)
        self.moving: list[Artist] = [*self.feeder.moving, self.title, self.subtitle]
        self.panels = [Panel((0.0, 0.0, MIDDLE, 1.0), [ax, self._colour_bar(figure), self._key(figure)])]

    def _map(self, ax: Axes, names: tuple[list[str], list[str]]) -> FeederMap:
        s = self.scenario
        return FeederMap(ax, s.feeder, positions(s.feeder), s.cost.band_pu, names)

    def _colour_bar(self, figure: Figure) -> Axes:
        ax = figure.add_axes((0.06, 0.105 + self.bottom, 0.42, 0.018))
        bar = figure.colorbar(self.feeder.dots, cax=ax, orientation="horizontal", extend="both")
        band, norm = self.scenario.cost.band_pu, voltage_norm(self.scenario.cost.band_pu)
        ticks = [norm.vmin, 1.0 - band, 1.0, 1.0 + band, norm.vmax]
        bar.set_ticks(ticks, labels=[f"{t:.3f}" for t in ticks])
        bar.set_label("voltage (p.u.); thick lines: limits", labelpad=2)
        ax.tick_params(length=3)
        ax.grid(False)
        for limit in (1.0 - band, 1.0 + band):
            ax.axvline(limit, ymin=-0.35, ymax=1.35, color="black", linewidth=3, clip_on=False)
        for k in (1, 3):
            ax.get_xticklabels()[k].set_fontweight("bold")
        return ax

    def _key(self, figure: Figure) -> Legend:
        handles, names = zip(*self._signs(), strict=True)
        return figure.legend(
            handles, names, loc="center", bbox_to_anchor=(0.27, 0.03), ncols=5, frameon=False, fontsize=9,
            columnspacing=self.spacing, handletextpad=0.3,
        )  # fmt: skip

    def _signs(self) -> list[tuple[Any, str]]:
        """Each sign of the map, and what it means."""
        others = ", ".join(other_kinds(self.scenario))
        entries = [
            (mark("s", 8), "substation"),
            *([(mark("^", 8), others)] if others else []),
            (mark("o", 9, width=1.8), "outside limits"),
        ]
        if self.scenario.n_sites:
            halo = mark("o", 13, width=0.0)
            halo.set(markerfacecolor=agent_colour(0), alpha=0.3)
            entries += [(mark("o", 10, agent_colour(0), 3.0), "data centre; arc: clock"), (halo, "halo: backlog")]
        return entries

    def update(self, history: History) -> list[Panel]:
        """Show the last step; the panels in which something moved that was thought to be still."""
        s, step = self.scenario, history.last
        moved = self.buses is None or not np.array_equal(self.buses, history.buses)
        if moved:
            self.buses = history.buses.copy()
            self.feeder.place(self.buses[: s.n_sites], self.buses[s.n_sites :])
        v = history.v_pu[step]
        dc = s.datacenters.parameters
        self.feeder.update(v, history.f_mhz[step] / dc.f_max_mhz, history.backlog_kws[step] / dc.p_rated_kw)
        scale, unit = self.time_unit
        t, end = step * s.dt_s / scale, s.horizon * s.dt_s / scale
        self.title.set_text(f"{s.name}   {s.split} split   t = {t:.4g} of {end:.4g} {unit}")
        lowest = int(np.argmin(v))
        outside, nodes = self.feeder.outside(v)[s.feeder.load_slice].sum(), len(s.feeder.load_nodes)
        one, many = node_words(s.feeder)
        self.subtitle.set_text(
            f"lowest voltage {v[lowest]:.4f} p.u. at {one} {s.feeder.node_ids[lowest]};   "
            f"{outside} of {nodes} {many} outside {_band(s)} p.u."
            if history.solved
            else "the power flow has no solution (voltage collapse); these are the last solved voltages"
        )
        return self.panels if moved else []


def mark(marker: Any, size: float, edge: str = INK, width: float = 1.0) -> Line2D:
    """A sign as the key shows it."""
    handle = Line2D([], [], marker=marker, markersize=size, linestyle="none", markerfacecolor="white")
    handle.set(markeredgecolor=edge, markeredgewidth=width)
    return handle


def by_rows(signs: list[tuple[Any, str]], columns: int = 5) -> list[tuple[Any, str]]:
    """Signs in the order in which a legend, which fills column by column, shows them row by row."""
    return [sign for column in range(columns) for sign in signs[column::columns]]


def other_kinds(scenario: Scenario) -> list[str]:
    """Return the kinds of devices other than sites of work and equipment of the feeder, in the scenario's order."""
    others = [device for device in scenario.devices if device.input != "workload" and not is_equipment(device)]
    return [device.kind for device in others if device.count]


def _band(scenario: Scenario) -> str:
    return f"{1.0 - scenario.cost.band_pu:.4g} to {1.0 + scenario.cost.band_pu:.4g}"


def time_unit(scenario: Scenario) -> tuple[float, str]:
    """Seconds in the unit in which the episode reads best, and its name."""
    span = scenario.horizon * scenario.dt_s
    return (1.0, "s") if span <= 1800.0 else (60.0, "min") if span <= 4 * 3600.0 else (3600.0, "h")
