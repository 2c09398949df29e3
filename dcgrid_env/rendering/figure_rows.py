"""Rows of the figure of a run: voltages, power over the feeder, equipment and each agent's figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.powerflow import three_phase_nodes
from dcgrid_env.rendering.equipment_labels import banks_of
from dcgrid_env.rendering.feeder_map import agent_colour
from dcgrid_env.rendering.history import node_words
from dcgrid_env.rendering.phase_curves import TAP_STYLES, UNBALANCE, feeder_phases, tap_looks
from dcgrid_env.rendering.replay_course import agent_figures, p_ref_kw, relay_curves
from dcgrid_env.scenario.scenario import Scenario

_SMALL: dict[str, Any] = {"fontsize": 8, "frameon": False}
_NAMED = 10
"""Agents named in a legend at most; with more, colours repeat."""
_WITHIN = 5
"""Agents whose legend is drawn among the curves at most; that of more is to the right of them."""
AGENT_LABELS = {
    "on_grid_pct": "connected (%)",
    "f_mhz": "GPU clock (MHz)",
    "backlog_kws": "backlog (kW s)",
    "stored_pct": "stored (%)",
    "burnt_kw": "burnt power (kW)",
}
"""Label of the row of each figure of agents, by its name in ``replay_course.SHOWN``, in the order of the rows."""
OVER_INTERVAL = ("f_mhz", "burnt_kw")
"""Figures that hold over an interval; the others are amounts at its end."""


class Row(NamedTuple):
    """A row of axes, one for each controller."""

    label: str
    height_in: float
    draw: Callable[[Axes, Series, np.ndarray], None]
    """Draws an episode at its times, s, (T + 1,)."""
    finish: Callable[[np.ndarray, list[Series]], None]
    """Fits the row's axes to all its episodes and puts the legend there."""


def voltages(ax: Axes, scenario: Scenario, run: Series, t: np.ndarray, nodes: np.ndarray, mean: bool = False) -> None:
    """How the voltages of some nodes spread, their median or ``mean``, and the lowest."""
    feeder = scenario.feeder
    one, many = node_words(feeder)
    v = run.v_pu[:, nodes]
    for share, alpha in ((0, 0.16), (10, 0.22), (25, 0.30)):
        low, high = np.percentile(v, [share, 100 - share], axis=1)
        label = {0: f"all {many}", 25: "middle half"}.get(share)
        ax.fill_between(t, low, high, color="#0072B2", alpha=alpha, linewidth=0, label=label)
    middle, called = (v.mean(axis=1), "mean") if mean else (np.median(v, axis=1), f"median {one}")
    ax.plot(t, middle, color="#003f63", linewidth=1.4, label=called)
    worst = int(np.argmin(v.min(axis=0)))
    lowest = feeder.node_ids[nodes[worst]]
    ax.plot(t, v[:, worst], color="#D55E00", linewidth=1.2, label=f"lowest: {one} {lowest}")
    for edge in (1.0 - scenario.cost.band_pu, 1.0 + scenario.cost.band_pu):
        ax.axhline(edge, color="black", linestyle="--", linewidth=0.9)
    ax.axhline(1.0, color="black", linewidth=0.5, alpha=0.5)


def fit_voltages(ax: Axes, scenario: Scenario, runs: list[Series]) -> None:
    """Limits for all voltages of all episodes, with room for a legend."""
    lowest = min(float(run.v_pu.min()) for run in runs)
    ax.set_ylim(min(lowest, 1.0 - scenario.cost.band_pu) - 0.01, 1.0 + 1.9 * scenario.cost.band_pu)


def phase_rows(scenario: Scenario, runs: list[Series]) -> list[Row]:
    """The rows of a three-phase feeder: phases, unbalance, and where taps move in an episode, taps and relays."""
    feeder: Any = scenario.feeder
    rows = [_phase(scenario, name, nodes) for name, nodes in feeder_phases(feeder).items()]
    if len(three_phase_nodes(feeder)):
        rows.append(_unbalance(feeder))
    if any(np.ptp(run.three_phase.equipment.regulators.tap, axis=0).any() for run in runs):
        rows.append(_taps(feeder))
        if relay_curves(runs[0]) is not None:
            rows.append(_relays(feeder))
    return rows


def voltage_row(scenario: Scenario) -> Row:
    """The row of a balanced feeder's voltages."""

    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        voltages(ax, scenario, run, t, scenario.feeder.load_nodes)

    def finish(across: np.ndarray, runs: list[Series]) -> None:
        fit_voltages(across[0], scenario, runs)
        across[0].legend(loc="upper right", ncols=2, columnspacing=1.0, **_SMALL)

    return Row("voltage (p.u.)", 2.8, draw, finish)


def total_rows(scenario: Scenario, runs: list[Series]) -> list[Row]:
    """The rows of sums over the feeder: power of the data centres, and reactive power of all agents."""
    rows = []
    if scenario.n_sites:
        rows.append(_total_power(scenario))
    if any(run.q_kvar.any() for run in runs):
        rows.append(_total_reactive_power())
    return rows


def agent_rows(scenario: Scenario, runs: list[Series]) -> list[Row]:
    """A row for each figure of ``AGENT_LABELS`` that changes in any of the episodes, with one curve for each agent."""
    figures = {id(run): agent_figures(run) for run in runs}
    names = _agent_names(scenario)

    def changes(name: str) -> bool:
        curves = [agent[name] for agents in figures.values() for agent in agents if name in agent]
        return any(np.ptp(curve[1:]) > 0.0 for curve in curves) or len({float(curve[-1]) for curve in curves}) > 1

    def row(name: str) -> Row:
        shown = [i for i, agent in enumerate(figures[id(runs[0])]) if name in agent]

        def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
            for place, i in enumerate(shown):
                values, look = figures[id(run)][i][name], {"color": agent_colour(place), "linewidth": 1.2}
                if name in OVER_INTERVAL:
                    ax.step(t[1:], values[1:], where="pre", label=names[i], **look)
                else:
                    ax.plot(t, values, label=names[i], **look)

        def finish(across: np.ndarray, runs: list[Series]) -> None:
            peak = _shown_peak(across)
            top = {"f_mhz": scenario.datacenters.f_max_mhz, "on_grid_pct": 100.0, "stored_pct": 100.0}.get(name, peak)
            across[0].set_ylim(-0.02 * max(top, 1.0), 1.05 * max(top, 1.0))
            if 0 < len(shown) <= _WITHIN:
                across[0].legend(loc="best", ncols=len(shown), **_SMALL)
            elif len(shown) <= _NAMED:
                across[-1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), labelspacing=0.2, **_SMALL)

        return Row(AGENT_LABELS[name], 1.8, draw, finish)

    return [row(name) for name in AGENT_LABELS if changes(name)]


def _shown_peak(across: np.ndarray) -> float:
    """Return the largest value of the curves of a row in the time that is shown."""
    first, last = across[0].get_xlim()
    curves = [line.get_xydata() for ax in across for line in ax.get_lines()]
    return max(float(xy[(xy[:, 0] >= first) & (xy[:, 0] <= last), 1].max(initial=0.0)) for xy in curves)


def _agent_names(scenario: Scenario) -> list[str]:
    """Name of each agent by its kind: ``dc_0`` and the like."""
    short = {"datacenter": "dc", "inverter": "inv", "storage": "sto"}
    return [f"{short.get(device.kind, device.kind)}_{i}" for device in scenario.devices for i in range(device.count)]


def _total_power(scenario: Scenario) -> Row:
    workload = [device.input == "workload" for device in scenario.devices for _ in range(device.count)]

    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        ax.step(t[1:], p_ref_kw(run)[1:].sum(axis=1), where="pre", color="#B5B5B5", linewidth=2.4, label="demand")
        ax.step(t[1:], run.p_kw[:, workload].sum(axis=1), where="pre", color="#1A1A1A", linewidth=1.2, label="drawn")

    def finish(across: np.ndarray, runs: list[Series]) -> None:
        across[0].set_ylim(0.0, 1.3 * across[0].get_ylim()[1])
        across[0].legend(loc="upper right", ncols=2, **_SMALL)

    return Row("data centres (kW)", 1.8, draw, finish)


def _total_reactive_power() -> Row:
    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        ax.step(t[1:], run.q_kvar.sum(axis=1), where="pre", color="#8C6BB1", linewidth=1.2)

    return Row("Q injected (kvar)", 1.5, draw, lambda across, runs: None)


def _phase(scenario: Scenario, name: str, nodes: np.ndarray) -> Row:
    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        voltages(ax, scenario, run, t, nodes, mean=True)

    def finish(across: np.ndarray, runs: list[Series]) -> None:
        fit_voltages(across[0], scenario, runs)
        highest = max(float(run.v_pu.max()) for run in runs)
        across[0].set_ylim(top=max(across[0].get_ylim()[1], highest + 0.6 * scenario.cost.band_pu))
        for ax in across:  # the lowest node differs
            ax.legend(loc="upper right", ncols=4, columnspacing=0.8, handlelength=1.2, handletextpad=0.4, **_SMALL)

    return Row(f"phase {name} (p.u.)", 2.0, draw, finish)


def _unbalance(feeder: Any) -> Row:
    buses = feeder.node_bus[three_phase_nodes(feeder)[:, 0]]

    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        percent = 100.0 * run.three_phase.unbalance
        bus = feeder.bus_ids[buses[int(np.argmax(percent.max(axis=0)))]]
        ax.plot(t, percent.max(axis=1), color=UNBALANCE, linewidth=1.4, label=f"largest (at its peak: bus {bus})")
        ax.plot(t, percent.mean(axis=1), color=UNBALANCE, linewidth=0.9, linestyle=(0, (3, 2)), label="mean")

    def finish(across: np.ndarray, runs: list[Series]) -> None:
        peak = max(float(run.three_phase.unbalance.max()) for run in runs)
        across[0].set_ylim(0.0, 1.35 * max(100.0 * peak, 0.1))
        for ax in across:
            ax.legend(loc="upper right", ncols=2, **_SMALL)

    return Row("V2 / V1 (%)", 1.5, draw, finish)


def _relays(feeder: Any) -> Row:
    looks = tap_looks(feeder)

    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        relays = relay_curves(run)
        assert relays is not None
        ax.axhspan(-1.0, 1.0, color="#1A1A1A", alpha=0.07, linewidth=0.0)
        for row, values in zip(relays.rows, relays.half_bands_off.T, strict=True):
            ax.plot(t, values, color=looks["colors"][row], linestyle=looks["linestyles"][row], linewidth=1.1)

    def finish(across: np.ndarray, runs: list[Series]) -> None:
        del runs
        across[-1].annotate("in band", (1.01, 0.0), xycoords=("axes fraction", "data"), va="center", fontsize=8)

    return Row("relay deviation\n(half bands)", 1.8, draw, finish)


def _taps(feeder: Any) -> Row:
    looks = tap_looks(feeder)
    phases = feeder.network.regulator.phases

    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        taps = run.three_phase.equipment.regulators.tap
        for tap, colour, style in zip(taps.T, looks["colors"], looks["linestyles"], strict=True):
            ax.step(t, tap, where="pre", color=colour, linestyle=style, linewidth=1.4)

    def finish(across: np.ndarray, runs: list[Series]) -> None:
        across[0].yaxis.set_major_locator(MaxNLocator(5, integer=True))
        entries = [Line2D([], [], color=bank.colour, linewidth=2.5, label=bank.name) for bank in banks_of(feeder)]
        kinds = sorted({of_tap if len(of_tap) == 1 else "" for of_tap in phases})
        look: dict[str, Any] = {"color": "#1A1A1A", "linewidth": 1.4}
        entries += [
            Line2D([], [], **look, linestyle=TAP_STYLES[kind], label=f"phase {kind}" if kind else "gang")
            for kind in kinds
        ]
        across[-1].legend(handles=entries, loc="upper left", bbox_to_anchor=(1.0, 1.0), **_SMALL)

    return Row("taps", 1.8, draw, finish)
