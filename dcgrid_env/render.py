"""The picture of a running episode: the feeder's voltages on its map, the episode's curves beside it."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from dcgrid_env.layout import INK, FeederMap, agent_colour, positions, voltage_norm
from dcgrid_env.scenario import Scenario

if TYPE_CHECKING:
    from dcgrid_env.simulation import Snapshot

_LOG = logging.getLogger(__name__)

SIZE_PX = (1360, 800)
_DPI = 100
# Not the user's rcParams: a frame looks the same everywhere.
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.edgecolor": "#888888",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "xtick.color": "#888888",
    "ytick.color": "#888888",
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
}
_INVERTER: dict[str, Any] = {"color": "#8C6BB1", "linewidth": 0.8, "zorder": 2.5}
_NAMED = 10
"""Data centres named in the legend at most."""


class History:
    """Lane 0 of the running episode, one row a step, in arrays that are made once; float32 is plenty for a picture."""

    def __init__(self, scenario: Scenario):
        rows, n_dc = scenario.horizon + 1, scenario.n_datacenters
        self.v_pu = np.empty((rows, scenario.feeder.n_bus), np.float32)
        self.f_mhz = np.empty((rows, n_dc), np.float32)
        self.backlog_kws = np.empty((rows, n_dc), np.float32)
        self.arrived_kw = np.empty((rows, n_dc), np.float32)
        self.p_kw = np.empty((rows, scenario.n_agents), np.float32)
        self.q_kvar = np.empty((rows, scenario.n_agents), np.float32)
        self.first = self.last = -1
        self.key: Any = None
        self.buses = np.empty(0, np.int64)
        self.solved = True

    def add(self, snapshot: Snapshot) -> None:
        """Copy lane 0: it is small, while a reference would keep the arrays of every lane alive."""
        step, state, episode = int(snapshot.step[0]), snapshot.state, snapshot.episode
        # A restored environment may go on from any step, of this episode or another.
        if step == 0 or episode.key[0] != self.key or not self.first <= step <= self.last + 1:
            self.first, self.key, self.buses = step, episode.key[0], episode.buses[0]
        self.last = step
        self.v_pu[step] = state.v_pu[0]
        self.f_mhz[step] = state.f_mhz[0]
        self.backlog_kws[step] = state.backlog_kws[0]
        self.arrived_kw[step] = state.arrived_kw[0]
        self.p_kw[step] = state.p_kw[0]
        self.q_kvar[step] = state.q_kvar[0]
        self.solved = snapshot.transition.converged[0]


class Viewer:
    """Draws lane 0 of a simulation.

    Parameters
    ----------
    scenario
        What is simulated.
    render_mode
        "rgb_array" (``draw`` gives an image) or "human" (it shows a window, where the session has a display).
    """

    def __init__(self, scenario: Scenario, render_mode: str):
        self.scenario = scenario
        self.render_mode = render_mode
        self._history = History(scenario)
        self._figure: Figure | None = None
        self._window: int | None = None

    def begin(self, snapshot: Snapshot) -> None:
        """Start a new episode's history, or go on if another lane was the one that was reset."""
        self._history.add(snapshot)

    def record(self, snapshot: Snapshot) -> None:
        """Take the step in; cheap, nothing is drawn."""
        self._history.add(snapshot)

    def draw(self) -> np.ndarray | None:
        """Draw the episode up to now: an image, uint8, (height, width, 3), or None for "human".

        RuntimeError before the first episode.
        """
        if self._history.last < 0:
            raise RuntimeError("nothing to draw yet; begin an episode first")
        if self._figure is None:
            with matplotlib.rc_context(), matplotlib.rc_context(_STYLE):
                self._figure = self._new_figure()
                self._panels = _Panels(self._figure, self.scenario)
                self._map = _Map(self._figure, self.scenario)
        if self._window is not None and not _is_open(self._window):
            return None
        self._map.update(self._history)
        self._panels.update(self._history)
        canvas: Any = self._figure.canvas
        canvas.draw()
        if self._window is not None:
            canvas.flush_events()
        if self.render_mode == "human":
            return None
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def close(self) -> None:
        """Close the window, if there is one, and forget the figure."""
        if self._window is not None:
            from matplotlib import pyplot

            pyplot.close(self._window)
        self._figure = self._window = None

    def _new_figure(self) -> Figure:
        size = (SIZE_PX[0] / _DPI, SIZE_PX[1] / _DPI)
        if self.render_mode == "human":
            figure = _open_window(size)
            if figure is not None:
                self._window = figure.number  # pyright: ignore[reportAttributeAccessIssue]
                return figure
        figure = Figure(size, dpi=_DPI, facecolor="white")
        FigureCanvasAgg(figure)
        return figure


def _open_window(size: tuple[float, float]) -> Figure | None:
    """A figure of pyplot's with a window, or None, logged, where there is no way to show one."""
    from matplotlib import pyplot
    from matplotlib.backend_bases import FigureManagerBase
    from matplotlib.backends.registry import backend_registry

    backend = matplotlib.get_backend()
    try:
        manager = backend_registry.load_backend_module(backend).FigureCanvas.manager_class
        # What a backend without windows has is the base class's show, which warns or does nothing.
        if manager.show is not FigureManagerBase.show:
            figure = pyplot.figure(figsize=size, dpi=_DPI, facecolor="white")
            figure.show()
            return figure
        reason = f"matplotlib's backend is {backend}"
    except Exception as error:  # each toolkit has errors of its own for a display that is not there
        reason = str(error)
    _LOG.warning("no window to show the environment in: %s; render_mode='rgb_array' gives images", reason)
    return None


def _is_open(number: int) -> bool:
    from matplotlib import pyplot

    return pyplot.fignum_exists(number)


class _Map:
    """The left half: title, feeder, colour bar, and what the signs mean."""

    def __init__(self, figure: Figure, scenario: Scenario):
        self.scenario = scenario
        self.time_unit = _time_unit(scenario)
        ax = figure.add_axes((0.01, 0.16, 0.52, 0.74))
        n_dc, n_inv = scenario.n_datacenters, scenario.n_inverters
        self.feeder = FeederMap(ax, scenario.feeder, positions(scenario.feeder), scenario.band_pu, n_dc, n_inv)
        self.buses: np.ndarray | None = None
        self.title = figure.text(0.015, 0.955, "", fontsize=13, fontweight="bold", va="center")
        self.subtitle = figure.text(0.015, 0.918, "", fontsize=10, va="center")
        self._colour_bar(figure)
        self._key(figure)

    def _colour_bar(self, figure: Figure) -> None:
        ax = figure.add_axes((0.06, 0.105, 0.42, 0.018))
        bar = figure.colorbar(self.feeder.dots, cax=ax, orientation="horizontal", extend="both")
        band, norm = self.scenario.band_pu, voltage_norm(self.scenario.band_pu)
        ticks = [norm.vmin, 1.0 - band, 1.0, 1.0 + band, norm.vmax]
        bar.set_ticks(ticks, labels=[f"{t:.4g}" for t in ticks])
        bar.set_label("voltage (p.u.); thick lines: limits", labelpad=2)
        ax.tick_params(length=3)
        ax.grid(False)
        for limit in (1.0 - band, 1.0 + band):
            ax.axvline(limit, ymin=-0.35, ymax=1.35, color="black", linewidth=3, clip_on=False)
        for k in (1, 3):
            ax.get_xticklabels()[k].set_fontweight("bold")

    def _key(self, figure: Figure) -> None:
        point = {"linestyle": "none", "markerfacecolor": "white", "markeredgecolor": INK}
        blue = agent_colour(0)
        entries = [
            (Line2D([], [], marker="s", markersize=8, **point), "substation"),
            (Line2D([], [], marker="^", markersize=8, **point), "inverter"),
            (Line2D([], [], marker="o", markersize=9, **(point | {"markeredgecolor": "black"}), mew=1.8), "outside"),
            (Line2D([], [], marker="o", markersize=10, **(point | {"markeredgecolor": blue}), mew=3), "clock (arc)"),
            (Line2D([], [], marker="o", markersize=13, color=blue, alpha=0.3, linestyle="none", mew=0), "backlog (halo)"),
        ]
        if self.scenario.n_datacenters == 0:
            entries = entries[:3]
        handles, names = zip(*entries, strict=True)
        figure.legend(
            handles, names, loc="center", bbox_to_anchor=(0.27, 0.03), ncols=5, frameon=False, columnspacing=1.4,
            handletextpad=0.3,
        )  # fmt: skip

    def update(self, history: History) -> None:
        s, step = self.scenario, history.last
        if self.buses is None or not np.array_equal(self.buses, history.buses):
            self.buses = history.buses.copy()
            self.feeder.place(self.buses[: s.n_datacenters], self.buses[s.n_datacenters :])
        v = history.v_pu[step]
        dc = s.datacenter
        share = history.f_mhz[step] / dc.f_max_mhz
        self.feeder.update(v, share, history.backlog_kws[step] / dc.p_rated_kw)
        scale, unit = self.time_unit
        t, end = step * s.dt_s / scale, s.horizon * s.dt_s / scale
        self.title.set_text(f"{s.name}   {s.split} split   t = {t:.4g} of {end:.4g} {unit}")
        if not history.solved:
            self.subtitle.set_text("the power flow has no solution (voltage collapse); last solved voltages shown")
            return
        lowest = int(np.argmin(v))
        outside = int(self.feeder.outside(v).sum())
        self.subtitle.set_text(
            f"lowest voltage {v[lowest]:.4f} p.u. at bus {s.feeder.bus_ids[lowest]};   "
            f"{outside} of {s.feeder.n_bus} buses outside {1 - s.band_pu:.4g} to {1 + s.band_pu:.4g} p.u."
        )


class _Panels:
    """The right half: curves over the episode's time, stacked."""

    def __init__(self, figure: Figure, scenario: Scenario):
        self.scenario = s = scenario
        self.figure = figure
        self.scale, unit = _time_unit(s)
        rows = 5 if s.n_datacenters else 2
        grid = figure.add_gridspec(
            rows, 1, left=0.61, right=0.985, top=0.87, bottom=0.07, hspace=0.16, height_ratios=[2.1] + [1.0] * (rows - 1)
        )
        self.axes: list[Axes] = []
        for k in range(rows):
            ax = figure.add_subplot(grid[k, 0], sharex=self.axes[0] if k else None)
            ax.tick_params(labelbottom=k == rows - 1, bottom=k == rows - 1)
            ax.yaxis.set_major_locator(MaxNLocator(3 if k else 6, steps=[1, 2, 4, 5, 10]))
            self.axes.append(ax)
        self.axes[0].set_xlim(0.0, s.horizon * s.dt_s / self.scale)
        self.axes[-1].set_xlabel(f"time ({unit})", labelpad=2)
        self._draw_voltage(self.axes[0])
        self.curves = {"v": self._curves(0, s.n_agents, steps=False), "q_kvar": self._curves(1, s.n_agents)}
        limit = float(np.concatenate((s.datacenter.q_max_kvar, s.inverter.s_rated_kva)).max())
        self._label(1, "reactive\n(kvar)", (-1.1 * limit, 1.1 * limit))
        if s.n_datacenters:
            n, p_rated = s.n_datacenters, float(s.datacenter.p_rated_kw.max())
            self.curves["p_ref"] = self._curves(2, n, linewidth=3.0, alpha=0.35)
            self.curves["p_kw"] = self._curves(2, n)
            self.curves["f_mhz"] = self._curves(3, n)
            self.curves["backlog_kws"] = self._curves(4, n, steps=False)
            self._label(2, "power\n(kW)", (0.0, 1.1 * p_rated))
            self._label(3, "clock\n(MHz)", (0.0, 1.1 * s.f_max_mhz))
            self._label(4, "backlog\n(kW s)", (0.0, p_rated))
        figure.align_ylabels(self.axes)
        self._draw_key()
        self.named: Any = None
        self.buses: np.ndarray | None = None

    def _label(self, k: int, name: str, limits: tuple[float, float]) -> None:
        self.axes[k].set_ylabel(name)
        self.axes[k].set_ylim(*limits)
        self.axes[k].yaxis.set_major_formatter("{x:,.4g}" if k == 0 else "{x:,.0f}")

    def _draw_voltage(self, ax: Axes) -> None:
        s = self.scenario
        self._label(0, "voltage\n(p.u.)", (0.9, 1.1))
        for limit in (1.0 - s.band_pu, 1.0 + s.band_pu):
            ax.axhline(limit, color="black", linewidth=1.1, linestyle=(0, (5, 3)))
        self.range = PolyCollection([], facecolors="#D5D5D5", linewidths=0)
        ax.add_collection(self.range, autolim=False)
        (self.mean,) = ax.plot([], [], color="black", linewidth=1.4, zorder=2.6)

    def _curves(self, k: int, n: int, *, steps: bool = True, **look: Any) -> list[Line2D]:
        """Empty curves for ``n`` agents; what acts over an interval is stored at its end, hence steps before."""
        lines = []
        for i in range(n):
            dc = i < self.scenario.n_datacenters
            own = {"color": agent_colour(i), "linewidth": 1.5, "zorder": 3} if dc else _INVERTER
            style = "steps-pre" if steps else "default"
            lines += self.axes[k].plot([], [], drawstyle=style, **(own | look))
        return lines

    def _draw_key(self) -> None:
        entries: list[tuple[Any, str]] = [
            (Patch(facecolor="#D5D5D5"), "all buses"),
            (Line2D([], [], color="black", linewidth=1.4), "mean"),
            (Line2D([], [], color="black", linewidth=1.1, linestyle=(0, (5, 3))), "limits"),
        ]
        if self.scenario.n_inverters:
            entries.append((Line2D([], [], **_INVERTER), "inverters"))
        if self.scenario.n_datacenters:
            entries.append((Line2D([], [], color=agent_colour(0), linewidth=3.0, alpha=0.35), "power asked for"))
        self._legend(entries, 0.885)

    def _legend(self, entries: list[tuple[Any, str]], y: float) -> Any:
        handles, names = zip(*entries, strict=True)
        return self.figure.legend(
            handles, names, loc="lower center", bbox_to_anchor=(0.797, y), ncols=5, frameon=False, borderpad=0.0,
            handlelength=1.4, handletextpad=0.4, columnspacing=1.3, labelspacing=0.3, borderaxespad=0.0,
        )  # fmt: skip

    def _name_datacenters(self, buses: np.ndarray) -> None:
        if self.named is not None:
            self.named.remove()
        n, ids = self.scenario.n_datacenters, self.scenario.feeder.bus_ids
        entries: list[tuple[Any, str]] = [
            (Line2D([], [], color=agent_colour(i), linewidth=2.5), f"dc_{i} (bus {ids[buses[i]]})")
            for i in range(min(n, _NAMED))
        ]
        if n > _NAMED:
            entries[-1] = (Line2D([], [], linestyle="none"), f"and {n - _NAMED + 1} more")
        self.named = self._legend(entries, 0.915) if entries else None

    def update(self, history: History) -> None:
        s, steps = self.scenario, slice(history.first, history.last + 1)
        if self.buses is None or not np.array_equal(self.buses, history.buses):
            self.buses = history.buses.copy()
            self._name_datacenters(self.buses)
        t = np.arange(steps.start, steps.stop) * (s.dt_s / self.scale)
        v = history.v_pu[steps]
        low, high = v.min(axis=1), v.max(axis=1)
        self.range.set_verts([np.column_stack((np.r_[t, t[::-1]], np.r_[low, high[::-1]]))])
        self.mean.set_data(t, v[:, 1:].mean(axis=1))
        values = {"v": v[:, self.buses], "p_ref": history.arrived_kw[steps] + s.datacenter.p_idle_kw}
        for name, lines in self.curves.items():
            rows = values[name] if name in values else getattr(history, name)[steps]
            for line, y in zip(lines, rows.T, strict=False):
                line.set_data(t, y)
        step = 0.5 * (s.band_pu or 0.05)
        below, above = np.floor((low.min() - 1.0) / step - 0.1), np.ceil((high.max() - 1.0) / step + 0.1)
        self.axes[0].set_ylim(1.0 + step * min(below, -2.5), 1.0 + step * max(above, 2.5))
        if s.n_datacenters:
            most = float(history.backlog_kws[steps].max())
            self.axes[4].set_ylim(0.0, _round_up(max(1.05 * most, s.datacenter.p_rated_kw.max())))


def _time_unit(scenario: Scenario) -> tuple[float, str]:
    """Seconds in the unit in which the episode reads best, and its name."""
    span = scenario.horizon * scenario.dt_s
    return (1.0, "s") if span <= 1800.0 else (60.0, "min") if span <= 4 * 3600.0 else (3600.0, "h")


def _round_up(value: float) -> float:
    """The next of 1, 2, 5, 10, .. that is not smaller, so that an axis moves seldom."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= value))
