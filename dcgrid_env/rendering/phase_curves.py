"""The right half of the picture of a three-phase feeder: its phases' spread, its unbalance and taps over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from dcgrid_env.engine.physics.connections import agent_nodes
from dcgrid_env.powerflow import three_phase_nodes
from dcgrid_env.rendering.episode_curves import Bundle, Curves, Spread, round_up
from dcgrid_env.rendering.equipment_labels import banks_of
from dcgrid_env.rendering.history import History, sites_first
from dcgrid_env.rendering.map_panel import Panel, by_rows
from dcgrid_env.scenario.grid_control import regulator_deciders
from dcgrid_env.scenario.scenario import Scenario

TAP_STYLES: dict[str, Any] = {"a": "solid", "b": (0, (5, 2)), "c": (0, (1.2, 1.2)), "": (0, (6, 1.5, 1.2, 1.5))}
"""Lines of a regulator of one phase, by its phase; the last for one of several."""
UNBALANCE = "#8E0152"


def tap_looks(feeder: Any) -> dict[str, list[Any]]:
    """Colours and styles of the lines of each regulator's tap, in the order of their table."""
    phases = feeder.network.regulator.phases
    colours = {row: bank.colour for bank in banks_of(feeder) for row in bank.rows}
    styles = [TAP_STYLES.get(of_tap, TAP_STYLES[""]) for of_tap in phases]
    return {"colors": [colours[row] for row in range(len(phases))], "linestyles": styles}


def feeder_phases(feeder: Any) -> dict[str, np.ndarray]:
    """Nodes of each phase that a feeder has, but the substation's, in the order of their buses."""
    nodes = feeder.load_nodes
    by_phase = {name: nodes[feeder.node_phase[nodes] == k + 1] for k, name in enumerate("abc")}
    return {name: of_phase for name, of_phase in by_phase.items() if len(of_phase)}


def taps_act(scenario: Scenario) -> bool:
    """Whether a regulator's tap may move in an episode."""
    feeder: Any = scenario.feeder
    return any(decider != "fixed" for decider in regulator_deciders(scenario.grid_control, feeder))


class PhaseCurves(Curves):
    """The right half: voltages by phase, unbalance, taps, and what the devices do, over the episode's time."""

    columns = 6
    gap = 0.21
    most_marks = 4.0
    rest_ratio = 0.8
    names_at = 0.938

    def _head_ratios(self) -> list[float]:
        feeder: Any = self.scenario.feeder
        self.nodes = feeder_phases(feeder)
        self.has_unbalance, self.has_taps = len(three_phase_nodes(feeder)) > 0, taps_act(self.scenario)
        return [1.0] * len(self.nodes) + [0.7] * self.has_unbalance + [0.7] * self.has_taps

    def _draw_heads(self) -> list[Artist]:
        s, axes = self.scenario, iter(self.heads)
        self.voltages: list[Spread] = []
        self.by_phase: dict[str, Bundle] = {}
        for name in self.nodes:
            ax = next(axes)
            self._label(ax, f"voltage {name}\n(p.u.)", (0.9, 1.1), "{x:.3f}")
            self.voltages.append(Spread(ax, s.cost.band_pu))
            self.by_phase[name] = Bundle(ax, *self.agents, steps=False, linewidths=1.2)
        moving: list[Artist] = [artist for spread in self.voltages for artist in spread.artists]
        moving += [lines for bundle in self.by_phase.values() for lines in bundle.lines]
        if self.has_unbalance:
            ax = self.unbalance_axes = next(axes)
            self._label(ax, "V2 / V1\n(%)", (0.0, 1.0), "{x:g}")
            ax.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
            (self.largest,) = ax.plot([], [], color=UNBALANCE, linewidth=1.5)
            (self.mean_unbalance,) = ax.plot([], [], color=UNBALANCE, linewidth=0.9, linestyle=(0, (3, 2)))
            moving += [self.largest, self.mean_unbalance]
        if self.has_taps:
            ax = self.taps_axes = next(axes)
            self._label(ax, "taps", (-4.0, 4.0))
            ax.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 4, 5, 10], integer=True))
            looks: Any = tap_looks(s.feeder) | {"linewidths": 1.3}
            self.taps = Bundle(ax, len(looks["colors"]), 0, steps=True, **looks)
            moving += self.taps.lines
        self.placed: Any = None
        self.settled_heads: dict[str, Any] = {}
        return moving

    def _signs(self) -> list[tuple[Any, str]]:
        signs = super()._signs()
        feeder: Any = self.scenario.feeder
        kinds = (
            {of_tap if len(of_tap) == 1 else "" for of_tap in feeder.network.regulator.phases} if self.has_taps else {}
        )
        look = {"color": "#1A1A1A", "linewidth": 1.3}
        taps = [(Line2D([], [], **look, linestyle=TAP_STYLES[kind]), f"tap {kind}") for kind in sorted(kinds)]
        if "" in kinds:
            signs.append((taps.pop(0)[0], "gang's tap"))
        if self.has_unbalance:
            signs += [(self.largest, "largest V2 / V1"), (self.mean_unbalance, "mean V2 / V1")]
        signs += taps
        return by_rows(signs, self.columns)

    def update(self, history: History) -> list[Panel]:
        """Show all steps; the panels in which something moved that was thought to be still."""
        changed = super().update(history)
        phases: Any = history.phases
        span = slice(history.first, history.last + 1)
        t = np.arange(history.first, history.last + 1) * (self.scenario.dt_s / self.scale)
        if self.has_unbalance:
            factor = 100.0 * phases.unbalance[span]
            self.largest.set_data(t, factor.max(axis=1))
            self.mean_unbalance.set_data(t, factor.mean(axis=1))
            top = float(np.fmax.reduce(factor, axis=None, initial=0.0))
            changed = changed + self._settle_head(self.unbalance_axes, (0.0, round_up(max(1.05 * top, 0.5))))
        if self.has_taps:
            taps = phases.tap[span]
            self.taps.show(t, taps)
            limits = float(taps.min()) - 1.5, float(taps.max()) + 1.5
            changed = changed + self._settle_head(self.taps_axes, limits)
        return changed

    def _settle_head(self, ax: Any, limits: tuple[float, float]) -> list[Panel]:
        if self.settled_heads.get(ax) == limits:
            return []
        self.settled_heads[ax] = limits
        ax.set_ylim(*limits)
        return [self.panels[1 + self.axes.index(ax)]]

    def _show_voltages(self, history: History, t: np.ndarray) -> tuple[float, float]:
        v = history.v_pu[history.first : history.last + 1]
        agent_nodes = self._agents_nodes(history)
        for spread, (name, nodes) in zip(self.voltages, self.nodes.items(), strict=True):
            bus_v = v[:, nodes]
            spread.show(t, bus_v.min(axis=1), bus_v.max(axis=1), bus_v.mean(axis=1))
            columns = agent_nodes[name]
            self.by_phase[name].show(t, np.where(columns < 0, np.nan, v[:, columns]))
        judged = v[:, self.scenario.feeder.load_slice]
        return float(np.fmin.reduce(judged, axis=None)), float(np.fmax.reduce(judged, axis=None))

    def _agents_nodes(self, history: History) -> dict[str, np.ndarray]:
        """Node of each agent in the picture at each phase, -1 where it is not connected to it, (n_agent,) each."""
        s = self.scenario
        feeder: Any = s.feeder
        buses = history.episode.buses[history.env_index]
        if self.placed is None or not np.array_equal(buses, self.placed[0]):
            connected = agent_nodes(s, buses[None])[0][sites_first(s)]
            by_phase = {}
            for k, name in enumerate("abc"):
                on_phase = feeder.node_phase[connected] == k + 1
                by_phase[name] = np.where(on_phase, connected, -1).max(axis=1, initial=-1)
            self.placed = buses.copy(), by_phase
        return self.placed[1]
