"""The two halves of the picture: the feeder's map, and the curves of the episode."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from dcgrid_env.history import History
from dcgrid_env.layout import INK, FeederMap, agent_colour, positions, voltage_norm
from dcgrid_env.scenario import Scenario

_INVERTER: dict[str, Any] = {"color": "#8C6BB1", "linewidth": 0.8, "zorder": 2.5}
_LIMIT: dict[str, Any] = {"color": "black", "linewidth": 1.1, "linestyle": (0, (5, 3))}
_NAMED = 10
"""Data centres named in the legend at most."""


class MapPart:
    """The left half: title, feeder, colour bar, and what the signs mean."""

    def __init__(self, figure: Figure, scenario: Scenario):
        self.scenario = scenario
        self.time_unit = _time_unit(scenario)
        ax = figure.add_axes((0.01, 0.155, 0.52, 0.735))
        n_dc, n_inv = scenario.n_datacenters, scenario.n_inverters
        self.feeder = FeederMap(ax, scenario.feeder, positions(scenario.feeder), scenario.band_pu, n_dc, n_inv)
        self.buses: np.ndarray | None = None
        self.title = figure.text(0.015, 0.955, "", fontsize=13, fontweight="bold", va="center")
        self.subtitle = figure.text(0.015, 0.918, "", fontsize=10, va="center")
        self.moving: list[Artist] = [*self.feeder.moving, self.title, self.subtitle]
        self._colour_bar(figure)
        self._key(figure)

    def _colour_bar(self, figure: Figure) -> None:
        ax = figure.add_axes((0.06, 0.105, 0.42, 0.018))
        bar = figure.colorbar(self.feeder.dots, cax=ax, orientation="horizontal", extend="both")
        band, norm = self.scenario.band_pu, voltage_norm(self.scenario.band_pu)
        ticks = [norm.vmin, 1.0 - band, 1.0, 1.0 + band, norm.vmax]
        bar.set_ticks(ticks, labels=[f"{t:.3f}" for t in ticks])
        bar.set_label("voltage (p.u.); thick lines: limits", labelpad=2)
        ax.tick_params(length=3)
        ax.grid(False)
        for limit in (1.0 - band, 1.0 + band):
            ax.axvline(limit, ymin=-0.35, ymax=1.35, color="black", linewidth=3, clip_on=False)
        for k in (1, 3):
            ax.get_xticklabels()[k].set_fontweight("bold")

    def _key(self, figure: Figure) -> None:
        def mark(marker: str, size: float, edge: str = INK, width: float = 1.0) -> Line2D:
            handle = Line2D([], [], marker=marker, markersize=size, linestyle="none", markerfacecolor="white")
            handle.set(markeredgecolor=edge, markeredgewidth=width)
            return handle

        entries = [
            (mark("s", 8), "substation"),
            (mark("^", 8), "inverter"),
            (mark("o", 9, width=1.8), "outside limits"),
        ]
        if self.scenario.n_datacenters:
            halo = mark("o", 13, width=0.0)
            halo.set(markerfacecolor=agent_colour(0), alpha=0.3)
            entries += [(mark("o", 10, agent_colour(0), 3.0), "data centre; arc: clock"), (halo, "halo: backlog")]
        handles, names = zip(*entries, strict=True)
        figure.legend(
            handles, names, loc="center", bbox_to_anchor=(0.27, 0.03), ncols=5, frameon=False, fontsize=9,
            columnspacing=1.2, handletextpad=0.3,
        )  # fmt: skip

    def update(self, history: History) -> bool:
        """Show the last step; True if something moved that was thought to be still."""
        s, step = self.scenario, history.last
        moved = self.buses is None or not np.array_equal(self.buses, history.buses)
        if moved:
            self.buses = history.buses.copy()
            self.feeder.place(self.buses[: s.n_datacenters], self.buses[s.n_datacenters :])
        v = history.v_pu[step]
        dc = s.datacenter
        share = history.f_mhz[step] / dc.f_max_mhz
        self.feeder.update(v, share, history.backlog_kws[step] / dc.p_rated_kw)
        scale, unit = self.time_unit
        t, end = step * s.dt_s / scale, s.horizon * s.dt_s / scale
        self.title.set_text(f"{s.name}   {s.split} split   t = {t:.4g} of {end:.4g} {unit}")
        lowest = int(np.argmin(v))
        self.subtitle.set_text(
            f"lowest voltage {v[lowest]:.4f} p.u. at bus {s.feeder.bus_ids[lowest]};   "
            f"{self.feeder.outside(v)[1:].sum()} of {s.feeder.n_bus - 1} buses outside {_band(s)} p.u."
            if history.solved
            else "the power flow has no solution (voltage collapse); these are the last solved voltages"
        )
        return moved


class Curves:
    """The right half: curves over the episode's time, stacked."""

    def __init__(self, figure: Figure, scenario: Scenario):
        self.scenario = s = scenario
        self.figure = figure
        self.scale, unit = _time_unit(s)
        rows = 5 if s.n_datacenters else 2
        place = {"left": 0.61, "right": 0.985, "top": 0.87, "bottom": 0.07, "hspace": 0.16}
        ratios = [2.1] + [1.0] * (rows - 1)
        self.axes: list[Axes] = list(figure.subplots(rows, 1, sharex=True, height_ratios=ratios, gridspec_kw=place))
        for ax in self.axes:
            ax.tick_params(labelsize=9.0, color="#888888", labelcolor=INK, bottom=ax is self.axes[-1])
            ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 4, 5, 10]))
        self.axes[0].set_xlim(0.0, s.horizon * s.dt_s / self.scale)
        self.axes[-1].set_xlabel(f"time ({unit})", labelpad=2)
        self._draw_voltage()
        limit = float(np.concatenate((s.datacenter.q_max_kvar, s.inverter.s_rated_kva)).max())
        self._label(1, "q injected\n(kvar)", (-1.1 * limit, 1.1 * limit))
        self.curves = {"v_pu": self._curves(0, s.n_agents, steps=False), "q_kvar": self._curves(1, s.n_agents)}
        if s.n_datacenters:
            self._draw_datacenters()
        self.moving: list[Artist] = [self.range, self.mean, *self.limits]
        self.moving += [line for lines in self.curves.values() for line in lines]
        self.moving.sort(key=lambda artist: artist.get_zorder())
        figure.align_ylabels(self.axes)
        self._draw_keys()
        self.settled: tuple[Any, ...] = ()

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
        s, n = self.scenario, self.scenario.n_datacenters
        p_rated = float(s.datacenter.p_rated_kw.max())
        self._label(2, "p drawn\n(kW)", (0.0, 1.1 * s.boost_share * p_rated))
        self._label(3, "clock\n(MHz)", (0.0, 1.1 * s.f_max_mhz))
        self._label(4, "backlog\n(kW s)", (0.0, p_rated))
        self.axes[3].set_yticks([s.f_min_mhz, 0.5 * (s.f_min_mhz + s.f_max_mhz), s.f_max_mhz])
        self.curves["p_ref_kw"] = self._curves(2, n, linewidth=3.0, alpha=0.35)
        self.curves["p_kw"] = self._curves(2, n)
        self.curves["f_mhz"] = self._curves(3, n)
        self.curves["backlog_kws"] = self._curves(4, n, steps=False)

    def _curves(self, k: int, n: int, *, steps: bool = True, **look: Any) -> list[Line2D]:
        """Empty curves for ``n`` agents; what acts over an interval is stored at its end, hence steps before."""
        lines = []
        for i in range(n):
            dc = i < self.scenario.n_datacenters
            own = {"color": agent_colour(i), "linewidth": 1.5, "zorder": 3} if dc else _INVERTER
            style = "steps-pre" if steps else "default"
            lines += self.axes[k].plot([], [], drawstyle=style, **(own | look))
        return lines

    def _draw_keys(self) -> None:
        n = self.scenario.n_datacenters
        entries: list[tuple[Any, str]] = [
            (Patch(facecolor="#D5D5D5"), "all buses"),
            (Line2D([], [], color="black", linewidth=1.4), "mean"),
            (Line2D([], [], **_LIMIT), "limits"),
        ]
        if self.scenario.n_inverters:
            entries.append((Line2D([], [], **_INVERTER), "inverters"))
        if n:
            entries.append((Line2D([], [], color=agent_colour(0), linewidth=3.0, alpha=0.35), "p asked for"))
        self._legend(entries, 0.885)
        entries = [(Line2D([], [], color=agent_colour(i), linewidth=2.5), f"dc_{i}") for i in range(min(n, _NAMED))]
        self.names = self._legend(entries, 0.913).get_texts()

    def _legend(self, entries: list[tuple[Any, str]], y: float) -> Any:
        return self.figure.legend(
            [handle for handle, _ in entries], [name for _, name in entries], loc="lower center", fontsize=9,
            bbox_to_anchor=(0.777, y), ncols=5, frameon=False, handlelength=1.0, handletextpad=0.4, columnspacing=1.0,
            labelspacing=0.3, borderpad=0.0, borderaxespad=0.0,
        )  # fmt: skip

    def update(self, history: History) -> bool:
        """Show all steps; True if something moved that was thought to be still."""
        s, steps = self.scenario, np.arange(history.first, history.last + 1)
        t, v = steps * (s.dt_s / self.scale), history.v_pu[steps]
        low, high = v.min(axis=1), v.max(axis=1)
        self.range.set_verts([np.column_stack((np.r_[t, t[::-1]], np.r_[low, high[::-1]]))])
        self.mean.set_data(t, v[:, 1:].mean(axis=1))
        values = {"v_pu": v[:, history.buses], "p_ref_kw": history.p_ref_kw(s, steps)}
        for name, lines in self.curves.items():
            rows = values[name] if name in values else getattr(history, name)[steps]
            for line, y in zip(lines, rows.T, strict=False):
                line.set_data(t, y)
        backlog = history.backlog_kws[steps].max(initial=0.0)
        return self._settle(history.buses, float(low.min()), float(high.max()), float(backlog))

    def _settle(self, buses: np.ndarray, low: float, high: float, backlog: float) -> bool:
        """Fit the axes and the names of the data centres; True if that changes anything."""
        s, unit = self.scenario, self.scenario.band_pu or 0.05
        below = min(-1.25, 0.5 * np.floor(2.0 * (low - 1.0) / unit))
        above = max(1.25, 0.5 * np.ceil(2.0 * (high - 1.0) / unit))
        top = _round_up(max(1.05 * backlog, *s.datacenter.p_rated_kw, 1.0))
        settled = (below, above, top, *buses[: len(self.names)].tolist())
        if settled == self.settled:
            return False
        self.settled = settled
        self.axes[0].set_ylim(1.0 + unit * below, 1.0 + unit * above)
        every = np.ceil((above - below) / 8.0)
        marks = np.arange(np.ceil(below / every), np.floor(above / every) + 1)
        self.axes[0].set_yticks(1.0 + unit * every * marks)
        if s.n_datacenters:
            self.axes[4].set_ylim(0.0, top)
        for i, text in enumerate(self.names):
            text.set_text(f"dc_{i} (bus {s.feeder.bus_ids[buses[i]]})")
        return True


def _band(scenario: Scenario) -> str:
    return f"{1.0 - scenario.band_pu:.4g} to {1.0 + scenario.band_pu:.4g}"


def _time_unit(scenario: Scenario) -> tuple[float, str]:
    """Seconds in the unit in which the episode reads best, and its name."""
    span = scenario.horizon * scenario.dt_s
    return (1.0, "s") if span <= 1800.0 else (60.0, "min") if span <= 4 * 3600.0 else (3600.0, "h")


def _round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, .. that is not smaller, so that an axis moves seldom."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= value))
