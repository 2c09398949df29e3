"""The right half of the picture: the curves of the episode."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from dcgrid_env.rendering.feeder_map import INK, agent_colour
from dcgrid_env.rendering.history import History, node_words, sites_first
from dcgrid_env.rendering.map_panel import MIDDLE, Panel, other_kinds, time_unit
from dcgrid_env.scenario.scenario import Scenario

_OTHER: dict[str, Any] = {"color": "#8C6BB1", "linewidth": 0.8, "zorder": 2.5}
_LIMIT: dict[str, Any] = {"color": "black", "linewidth": 1.1, "linestyle": (0, (5, 3))}
_NAMED = 10
"""Data centres named in the legend at most."""
_DIGIT_PT, _COMMA_PT, _PAD_PT = 5.8, 2.9, 8.0
"""Widths of a digit, of a comma and of the space between figures, ticks and axis names, points."""
_NAME_PX = 33.5
"""Width of an axis's name in two lines."""


class Bundle:
    """Curves of several agents over time; with ``steps`` what acts over an interval is a step up to its end."""

    def __init__(self, ax: Axes, n_dc: int, n_other: int, *, steps: bool, **look: Any):
        self.n_dc, self.steps = n_dc, steps
        site_style = {"colors": [agent_colour(i) for i in range(n_dc)], "linewidths": 1.5, "zorder": 3} | look
        others = {"colors": _OTHER["color"], "linewidths": _OTHER["linewidth"], "zorder": _OTHER["zorder"]}
        ends: Any = {"capstyle": "projecting", "joinstyle": "round"}
        self.lines = [LineCollection([], **style, **ends) for style, n in ((site_style, n_dc), (others, n_other)) if n]
        for lines in self.lines:
            ax.add_collection(lines, autolim=False)

    def show(self, t: np.ndarray, values: np.ndarray) -> None:
        """Draw ``values`` (n_step, n_agent), data centres first, at the times ``t`` (n_step,)."""
        x, y = t, values.T
        if self.steps:
            x, y = np.repeat(t, 2)[:-1], np.repeat(y, 2, axis=1)[:, 1:]
        curves = np.stack((np.broadcast_to(x, y.shape), y), axis=-1)
        parts = [curves[: self.n_dc], curves[self.n_dc :]]
        for lines, part in zip(self.lines, [part for part in parts if len(part)], strict=True):
            lines.set_segments(list(part))


class Spread:
    """Voltages from the lowest to the highest, their mean, and the limits, on axes over time."""

    def __init__(self, ax: Axes, band_pu: float):
        self.limits = [ax.axhline(limit, zorder=2.7, **_LIMIT) for limit in (1.0 - band_pu, 1.0 + band_pu)]
        self.range = PolyCollection([], facecolors="#D5D5D5", linewidths=0)
        ax.add_collection(self.range, autolim=False)
        (self.mean,) = ax.plot([], [], color="black", linewidth=1.4, zorder=2.6)

    @property
    def artists(self) -> list[Artist]:
        """What ``show`` changes, and what must stay above it."""
        return [self.range, self.mean, *self.limits]

    def show(self, t: np.ndarray, low: np.ndarray, high: np.ndarray, mean: np.ndarray) -> None:
        """Draw the lowest, the highest and the mean voltage, p.u., at the times ``t``, (n_step,) each."""
        self.range.set_verts([np.column_stack((np.r_[t, t[::-1]], np.r_[low, high[::-1]]))])
        self.mean.set_data(t, mean)


class Curves:
    """The right half: curves over the episode's time, stacked."""

    columns = 5
    """Signs in a line of the key."""
    gap = 0.16
    """Space between axes next to their mean height."""
    most_marks = 8.0
    """Marks on an axis of voltages at most."""
    rest_ratio = 1.0
    """Height of the axes below the voltages' next to the ratios above."""
    names_at = 0.913
    """Position of the data centres' names in the figure, as a share of its height."""

    def __init__(self, figure: Figure, scenario: Scenario):
        self.scenario = s = scenario
        self.figure = figure
        self.scale, unit = time_unit(s)
        ratios = self._head_ratios()
        n_head, n_rest = len(ratios), 4 if s.n_sites else 1
        place = {"left": 0.61, "right": 0.985, "top": 0.87, "bottom": 0.07, "hspace": self.gap}
        ratios += [self.rest_ratio] * n_rest
        rows: Any = figure.subplots(n_head + n_rest, 1, sharex=True, height_ratios=ratios, gridspec_kw=place)
        self.axes: list[Axes] = list(rows)
        self.heads, self.rest = self.axes[:n_head], self.axes[n_head:]
        for ax in self.axes:
            ax.tick_params(labelsize=9.0, color="#888888", labelcolor=INK, bottom=ax is self.axes[-1])
            ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 4, 5, 10]))
        self.axes[0].set_xlim(0.0, s.horizon * s.dt_s / self.scale)
        self.axes[-1].set_xlabel(f"time ({unit})", labelpad=2)
        limit = float(s.q_scale_kvar.max()) or 1.0
        self._label(self.rest[0], "q injected\n(kvar)", (-1.1 * limit, 1.1 * limit))
        self.agents = s.n_sites, len(sites_first(s)) - s.n_sites
        self.curves = {"q_kvar": Bundle(self.rest[0], *self.agents, steps=True)}
        self.moving: list[Artist] = self._draw_heads()
        if s.n_sites:
            self._draw_datacenters()
        self.moving += [lines for bundle in self.curves.values() for lines in bundle.lines]
        self.moving.sort(key=lambda artist: artist.get_zorder())
        self.panels = self._panels()
        self.settled: dict[str, Any] = {}
        self.labels_at = 0.0
        self._place_labels()

    def _panels(self) -> list[Panel]:
        """One for the legends and one for each of the axes, whose labels reach half way to the next."""
        places = [ax.get_position() for ax in self.axes]
        edges = [0.88, *(0.5 * (upper.y0 + lower.y1) for upper, lower in pairwise(places)), 0.0]
        still = [self._draw_keys(), *([ax] for ax in self.axes)]
        return [
            Panel((MIDDLE, bottom, 1.0, top), artists)
            for (top, bottom), artists in zip(pairwise([1.0, *edges]), still, strict=True)
        ]

    def _label(self, ax: Axes, name: str, limits: tuple[float, float], figures: str = "{x:,.0f}") -> None:
        ax.set_ylabel(name)
        ax.set_ylim(*limits)
        ax.yaxis.set_major_formatter(figures)

    def _head_ratios(self) -> list[float]:
        """Heights of the axes above the powers', the voltages' first."""
        return [2.1]

    def _draw_heads(self) -> list[Artist]:
        """Draw what stands above the powers; the artists that move."""
        self._label(self.heads[0], "voltage\n(p.u.)", (0.9, 1.1), "{x:.3f}")
        self.voltages = [Spread(self.heads[0], self.scenario.cost.band_pu)]
        self.curves["v_pu"] = Bundle(self.heads[0], *self.agents, steps=False)
        return self.voltages[0].artists

    def _draw_datacenters(self) -> None:
        s, n = self.scenario, self.scenario.n_sites
        p_rated = float(s.datacenters.parameters.p_rated_kw.max())
        _, power, clock, backlog = self.rest
        self._label(power, "p drawn\n(kW)", (0.0, 1.1 * s.datacenters.boost_share * p_rated))
        self._label(clock, "clock\n(MHz)", (0.0, 1.1 * s.datacenters.f_max_mhz))
        self._label(backlog, "backlog\n(kW s)", (0.0, p_rated))
        clock.set_yticks(
            [
                s.datacenters.f_min_mhz,
                0.5 * (s.datacenters.f_min_mhz + s.datacenters.f_max_mhz),
                s.datacenters.f_max_mhz,
            ]
        )
        self.curves["p_ref_kw"] = Bundle(power, n, 0, steps=True, linewidths=3.0, alpha=0.35)
        self.curves["p_kw"] = Bundle(power, n, 0, steps=True)
        self.curves["f_mhz"] = Bundle(clock, n, 0, steps=True)
        self.curves["backlog_kws"] = Bundle(backlog, n, 0, steps=False)

    def _signs(self) -> list[tuple[Any, str]]:
        """Each kind of curve, and what it means."""
        n = self.scenario.n_sites
        entries: list[tuple[Any, str]] = [
            (Patch(facecolor="#D5D5D5"), f"all {node_words(self.scenario.feeder)[1]}"),
            (Line2D([], [], color="black", linewidth=1.4), "mean"),
            (Line2D([], [], **_LIMIT), "limits"),
        ]
        if others := other_kinds(self.scenario):
            called = "inverters" if others == ["inverter"] else ", ".join(others)
            entries.append((Line2D([], [], **_OTHER), called))
        if n:
            entries.append((Line2D([], [], color=agent_colour(0), linewidth=3.0, alpha=0.35), "p asked for"))
        return entries

    def _draw_keys(self) -> list[Artist]:
        n = self.scenario.n_sites
        lower = self._legend(self._signs(), 0.885, self.columns)
        entries = [(Line2D([], [], color=agent_colour(i), linewidth=2.5), f"dc_{i}") for i in range(min(n, _NAMED))]
        upper = self._legend(entries, self.names_at)
        self.names = upper.get_texts()
        return [lower, upper]

    def _legend(self, entries: list[tuple[Any, str]], y: float, columns: int = 5) -> Any:
        return self.figure.legend(
            [handle for handle, _ in entries], [name for _, name in entries], loc="lower center", fontsize=9,
            bbox_to_anchor=(0.777, y), ncols=columns, frameon=False, handlelength=1.0, handletextpad=0.4,
            columnspacing=1.0, labelspacing=0.3, borderpad=0.0, borderaxespad=0.0,
        )  # fmt: skip

    def update(self, history: History) -> list[Panel]:
        """Show all steps; the panels in which something moved that was thought to be still."""
        steps = np.arange(history.first, history.last + 1)
        t = steps * (self.scenario.dt_s / self.scale)
        low, high = self._show_voltages(history, t)
        for name, bundle in self.curves.items():
            bundle.show(t, self._values(history, name, steps))
        backlog = history.backlog_kws[steps].max(initial=0.0)
        return self._settle(history.buses, low, high, float(backlog))

    def _show_voltages(self, history: History, t: np.ndarray) -> tuple[float, float]:
        """Show how far the voltages spread at the times ``t``; the lowest and the highest of all."""
        v = history.v_pu[history.first : history.last + 1]
        low, high = v.min(axis=1), v.max(axis=1)
        self.voltages[0].show(t, low, high, v[:, self.scenario.feeder.load_slice].mean(axis=1))
        return float(low.min()), float(high.max())

    def _values(self, history: History, name: str, steps: np.ndarray) -> np.ndarray:
        """What the curves of a name show, (n_step, n_agent)."""
        if name == "v_pu":
            return history.v_pu[history.first : history.last + 1, history.buses]
        if name == "p_ref_kw":
            return history.p_ref_kw(self.scenario, steps)
        rows = getattr(history, name)[steps]
        return rows[:, : self.scenario.n_sites] if name == "p_kw" else rows

    def _settle(self, buses: np.ndarray, low: float, high: float, backlog: float) -> list[Panel]:
        """Fit the axes and the names of the data centres; the panels that this changes."""
        s, unit = self.scenario, self.scenario.cost.band_pu or 0.05
        below = min(-1.25, 0.5 * np.floor(2.0 * (low - 1.0) / unit))
        above = max(1.25, 0.5 * np.ceil(2.0 * (high - 1.0) / unit))
        top = round_up(max(1.05 * backlog, *s.datacenters.parameters.p_rated_kw, 1.0))
        settled = {"names": buses[: len(self.names)].tolist(), "voltage": (below, above), "backlog": top}
        changed = {name for name, value in settled.items() if self.settled.get(name) != value}
        self.settled = settled
        if "names" in changed:
            for text, (i, bus) in zip(self.names, enumerate(settled["names"]), strict=True):
                text.set_text(f"dc_{i} (bus {s.feeder.bus_ids[bus]})")
        if "voltage" in changed:
            every = np.ceil((above - below) / self.most_marks)
            marks = np.arange(np.ceil(below / every), np.floor(above / every) + 1)
            for ax in self.heads[: len(self.voltages)]:
                ax.set_ylim(1.0 + unit * below, 1.0 + unit * above)
                ax.set_yticks(1.0 + unit * every * marks)
        if "backlog" in changed and s.n_sites:
            ax = self.rest[3]
            ax.set_ylim(0.0, top)
            per_kws, unit = (1.0, "kW s") if top <= 1e6 else (1e-3, "MW s")  # long figures would not fit
            ax.set_ylabel(f"backlog\n({unit})")
            ax.yaxis.set_major_formatter(lambda x, _: f"{per_kws * x:,.0f}")
            if self._place_labels(per_kws * top):
                return self.panels
        panels = {
            "names": self.panels[:1],
            "voltage": self.panels[1 : 1 + len(self.voltages)],
            "backlog": self.panels[-1:],
        }
        return [panel for name in changed for panel in panels[name]]

    def _place_labels(self, highest: float = 0.0) -> bool:
        """Put the axes' names clear of the longest figure on any of them; True if that moves them."""
        limits = [limit for ax in self.rest[:3] for limit in ax.get_ylim()]
        figures = ["1.0000", *(f"{limit:,.0f}" for limit in (*limits, highest))]
        widest = max(_DIGIT_PT * len(text) - (_DIGIT_PT - _COMMA_PT) * text.count(",") for text in figures)
        left, width = self.axes[0].get_window_extent().x0, self.axes[0].get_window_extent().width
        room = left - MIDDLE * self.figure.bbox.width - _NAME_PX
        label_x = -min((widest + _PAD_PT) / 72.0 * self.figure.dpi, room) / width
        moved = label_x != self.labels_at
        self.labels_at = label_x
        for ax in self.axes if moved else ():
            ax.yaxis.set_label_coords(label_x, 0.5)
        return moved


def round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, .. that is not smaller, so that an axis moves seldom."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= value))
