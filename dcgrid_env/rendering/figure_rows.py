"""Rows of the figure of a run: voltages, on a three-phase feeder phases, unbalance and taps, and what storages hold."""

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
from dcgrid_env.rendering.phase_curves import TAP_STYLES, UNBALANCE, phases_of_feeder, tap_looks, taps_act
from dcgrid_env.scenario.scenario import Scenario

_SMALL: dict[str, Any] = {"fontsize": 8, "frameon": False}
_NAMED = 10
"""Storages named in the legend at most."""


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


def phase_rows(scenario: Scenario) -> list[Row]:
    """The rows of a three-phase feeder: its phases, and what it has of unbalance and of regulators that act."""
    feeder: Any = scenario.feeder
    rows = [_phase(scenario, name, nodes) for name, nodes in phases_of_feeder(feeder).items()]
    if len(three_phase_nodes(feeder)):
        rows.append(_unbalance(feeder))
    if taps_act(scenario):
        rows.append(_taps(feeder))
    return rows


def storage_rows(scenario: Scenario) -> list[Row]:
    """The row of storages that are agents, if there are any: stored energy as a share, each in its own colour."""
    group = next((device for device in scenario.devices if device.kind == "storage" and device.count), None)
    if group is None:
        return []
    energy_kwh = group.parameters.energy_kwh

    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        for i, share in enumerate((run.stored_kwh / energy_kwh).T):
            ax.plot(t, 100.0 * share, color=agent_colour(i), linewidth=1.2, label=f"sto_{i}")

    def finish(across: np.ndarray, runs: list[Series]) -> None:
        across[0].set_ylim(-2.0, 102.0)
        if len(energy_kwh) <= _NAMED:
            across[0].legend(loc="lower left", ncols=min(len(energy_kwh), 5), **_SMALL)

    return [Row("stored (%)", 1.8, draw, finish)]


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


def _taps(feeder: Any) -> Row:
    looks = tap_looks(feeder)
    phases = feeder.network.regulator.phases

    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        taps = run.three_phase.equipment.regulators.tap
        for own, colour, style in zip(taps.T, looks["colors"], looks["linestyles"], strict=True):
            ax.step(t, own, where="pre", color=colour, linestyle=style, linewidth=1.4)

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
