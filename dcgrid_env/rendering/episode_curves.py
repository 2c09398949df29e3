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
from dcgrid_env.rendering.history import History, node_words
from dcgrid_env.rendering.map_panel import MIDDLE, Panel, other_kinds, time_unit
from dcgrid_env.scenario.scenario import Scenario

_OTHER: dict[str, Any] = {"color": "#8C6BB1", "linewidth": 0.8, "zorder": 2.5}
_LIMIT: dict[str, Any] = {"color": "black", "linewidth": 1.1, "linestyle": (0, (5, 3))}
_NAMED = 10
"""Data centres named in the legend at most."""
_DIGIT_PT, _COMMA_PT, _PAD_PT = 5.8, 2.9, 8.0
"""Widths on the axes, and what stands between figures, ticks and the axes' names, points."""
_NAME_PX = 33.5
"""Width of an axis's name in two lines."""


class Bundle:
    """Curves of several agents over time; with ``steps`` what acts over an interval is a step up to its end."""

    def __init__(self, ax: Axes, n_dc: int, n_other: int, *, steps: bool, **look: Any):
        self.n_dc, self.steps = n_dc, steps
        own = {"colors": [agent_colour(i) for i in range(n_dc)], "linewidths": 1.5, "zorder": 3} | look
        others = {"colors": _OTHER["color"], "linewidths": _OTHER["linewidth"], "zorder": _OTHER["zorder"]}
        ends: Any = {"capstyle": "projecting", "joinstyle": "round"}
        self.lines = [LineCollection([], **style, **ends) for style, n in ((own, n_dc), (others, n_other)) if n]
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


class Curves:
    """The right half: curves over the episode's time, stacked."""

    def __init__(self, figure: Figure, scenario: Scenario):
        self.scenario = s = scenario
        self.figure = figure
        self.scale, unit = time_unit(s)
        rows = 5 if s.n_sites else 2
        place = {"left": 0.61, "right": 0.985, "top": 0.87, "bottom": 0.07, "hspace": 0.16}
        ratios = [2.1] + [1.0] * (rows - 1)
        self.axes: list[Axes] = list(figure.subplots(rows, 1, sharex=True, height_ratios=ratios, gridspec_kw=place))
        for ax in self.axes:
            ax.tick_params(labelsize=9.0, color="#888888", labelcolor=INK, bottom=ax is self.axes[-1])
            ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 4, 5, 10]))
        self.axes[0].set_xlim(0.0, s.horizon * s.dt_s / self.scale)
        self.axes[-1].set_xlabel(f"time ({unit})", labelpad=2)
        self._draw_voltage()
        limit = float(s.q_scale_kvar.max()) or 1.0
        self._label(1, "q injected\n(kvar)", (-1.1 * limit, 1.1 * limit))
        n_dc, n_other = s.n_sites, s.n_agents - s.n_sites
        self.curves = {
            "v_pu": Bundle(self.axes[0], n_dc, n_other, steps=False),
            "q_kvar": Bundle(self.axes[1], n_dc, n_other, steps=True),
        }
        if s.n_sites:
            self._draw_datacenters()
        self.moving: list[Artist] = [self.range, self.mean, *self.limits]
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

    def _label(self, k: int, name: str, limits: tuple[float, float]) -> None:
        self.axes[k].set_ylabel(name)
        self.axes[k].set_ylim(*limits)
        self.axes[k].yaxis.set_major_formatter("{x:.3f}" if k == 0 else "{x:,.0f}")

    def _draw_voltage(self) -> None:
        ax, band = self.axes[0], self.scenario.band_pu
        self._label(0, "voltage\n(p.u.)", (0.9, 1.1))
        self.limits = [ax.axhline(limit, zorder=2.7, **_LIMIT) for limit in (1.0 - band, 1.0 + band)]
        self.range = PolyCollection([], facecolors="#D5D5D5", linewidths=0)
        ax.add_collection(self.range, autolim=False)
        (self.mean,) = ax.plot([], [], color="black", linewidth=1.4, zorder=2.6)

    def _draw_datacenters(self) -> None:
        s, n = self.scenario, self.scenario.n_sites
        p_rated = float(s.datacenter.p_rated_kw.max())
        self._label(2, "p drawn\n(kW)", (0.0, 1.1 * s.boost_share * p_rated))
        self._label(3, "clock\n(MHz)", (0.0, 1.1 * s.f_max_mhz))
        self._label(4, "backlog\n(kW s)", (0.0, p_rated))
        self.axes[3].set_yticks([s.f_min_mhz, 0.5 * (s.f_min_mhz + s.f_max_mhz), s.f_max_mhz])
        self.curves["p_ref_kw"] = Bundle(self.axes[2], n, 0, steps=True, linewidths=3.0, alpha=0.35)
        self.curves["p_kw"] = Bundle(self.axes[2], n, 0, steps=True)
        self.curves["f_mhz"] = Bundle(self.axes[3], n, 0, steps=True)
        self.curves["backlog_kws"] = Bundle(self.axes[4], n, 0, steps=False)

    def _draw_keys(self) -> list[Artist]:
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
        lower = self._legend(entries, 0.885)
        entries = [(Line2D([], [], color=agent_colour(i), linewidth=2.5), f"dc_{i}") for i in range(min(n, _NAMED))]
        upper = self._legend(entries, 0.913)
        self.names = upper.get_texts()
        return [lower, upper]

    def _legend(self, entries: list[tuple[Any, str]], y: float) -> Any:
        return self.figure.legend(
            [handle for handle, _ in entries], [name for _, name in entries], loc="lower center", fontsize=9,
            bbox_to_anchor=(0.777, y), ncols=5, frameon=False, handlelength=1.0, handletextpad=0.4, columnspacing=1.0,
            labelspacing=0.3, borderpad=0.0, borderaxespad=0.0,
        )  # fmt: skip

    def update(self, history: History) -> list[Panel]:
        """Show all steps; the panels in which something moved that was thought to be still."""
        s, steps = self.scenario, np.arange(history.first, history.last + 1)
        t, v = steps * (s.dt_s / self.scale), history.v_pu[history.first : history.last + 1]
        low, high = v.min(axis=1), v.max(axis=1)
        self.range.set_verts([np.column_stack((np.r_[t, t[::-1]], np.r_[low, high[::-1]]))])
        self.mean.set_data(t, v[:, s.feeder.load_slice].mean(axis=1))
        by_bus = history.bus_v_pu(slice(history.first, history.last + 1))
        values = {"v_pu": by_bus[:, history.buses], "p_ref_kw": history.p_ref_kw(s, steps)}
        for name, bundle in self.curves.items():
            rows = values[name] if name in values else getattr(history, name)[steps]
            bundle.show(t, rows[:, : s.n_sites] if name == "p_kw" else rows)
        backlog = history.backlog_kws[steps].max(initial=0.0)
        return self._settle(history.buses, float(low.min()), float(high.max()), float(backlog))

    def _settle(self, buses: np.ndarray, low: float, high: float, backlog: float) -> list[Panel]:
        """Fit the axes and the names of the data centres; the panels that this changes."""
        s, unit = self.scenario, self.scenario.band_pu or 0.05
        below = min(-1.25, 0.5 * np.floor(2.0 * (low - 1.0) / unit))
        above = max(1.25, 0.5 * np.ceil(2.0 * (high - 1.0) / unit))
        top = _round_up(max(1.05 * backlog, *s.datacenter.p_rated_kw, 1.0))
        settled = {"names": buses[: len(self.names)].tolist(), "voltage": (below, above), "backlog": top}
        changed = {name for name, value in settled.items() if self.settled.get(name) != value}
        self.settled = settled
        if "names" in changed:
            for text, (i, bus) in zip(self.names, enumerate(settled["names"]), strict=True):
                text.set_text(f"dc_{i} (bus {s.feeder.bus_ids[bus]})")
        if "voltage" in changed:
            self.axes[0].set_ylim(1.0 + unit * below, 1.0 + unit * above)
            every = np.ceil((above - below) / 8.0)
            marks = np.arange(np.ceil(below / every), np.floor(above / every) + 1)
            self.axes[0].set_yticks(1.0 + unit * every * marks)
        if "backlog" in changed and s.n_sites:
            self.axes[4].set_ylim(0.0, top)
            per_kws, unit = (1.0, "kW s") if top <= 1e6 else (1e-3, "MW s")  # long figures would not fit
            self.axes[4].set_ylabel(f"backlog\n({unit})")
            self.axes[4].yaxis.set_major_formatter(lambda x, _: f"{per_kws * x:,.0f}")
            if self._place_labels(per_kws * top):
                return self.panels
        of = {"names": self.panels[:1], "voltage": self.panels[1:2], "backlog": self.panels[5:]}
        return [panel for name in changed for panel in of[name]]

    def _place_labels(self, highest: float = 0.0) -> bool:
        """Put the axes' names clear of the longest figure on any of them; True if that moves them."""
        limits = [limit for ax in self.axes[1:4] for limit in ax.get_ylim()]
        figures = ["1.0000", *(f"{limit:,.0f}" for limit in (*limits, highest))]
        widest = max(_DIGIT_PT * len(text) - (_DIGIT_PT - _COMMA_PT) * text.count(",") for text in figures)
        left, width = self.axes[0].get_window_extent().x0, self.axes[0].get_window_extent().width
        room = left - MIDDLE * self.figure.bbox.width - _NAME_PX
        at = -min((widest + _PAD_PT) / 72.0 * self.figure.dpi, room) / width
        moved = at != self.labels_at
        self.labels_at = at
        for ax in self.axes if moved else ():
            ax.yaxis.set_label_coords(at, 0.5)
        return moved


def _round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, .. that is not smaller, so that an axis moves seldom."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= value))
