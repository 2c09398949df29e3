"""The figure of a run: one episode under several controllers, voltages, clocks and backlog over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.rendering.banded_figure import long_figure
from dcgrid_env.rendering.envelope import Envelope
from dcgrid_env.rendering.feeder_map import agent_colour
from dcgrid_env.rendering.figure_rows import Row, fit_voltages, phase_rows, storage_rows, voltages
from dcgrid_env.scenario.scenario import Scenario

MOST_NAMED = 10
"""Data centres up to which a figure names each; beyond, colours have repeated and a legend would hide the curves."""

MOST_STEPS = 6000
"""Steps up to which a line is drawn through each of them."""
_REST_IN = 8.2 / 3.0
"""Height of a row of the devices, inches."""


def run_figure(scenario: Scenario, series: dict[str, Series], seed: int) -> Figure:
    """Columns are controllers; rows are voltages, clocks and backlog, each on one scale for all.

    The voltages of a three-phase feeder take a row for each phase, and its unbalance and taps one each. What storages
    hold has a row of its own. Episodes of more than ``MOST_STEPS`` are drawn as ``long_figure`` has it.
    """
    if scenario.horizon > MOST_STEPS:
        return long_figure(scenario, {name: Envelope.of(run) for name, run in series.items()}, seed)
    by_phase = isinstance(scenario.feeder, ThreePhaseFeeder)
    rows = [*(phase_rows(scenario) if by_phase else _balanced_rows(scenario)), *storage_rows(scenario)]
    heights = [row.height_in for row in rows] + [2.0 if by_phase else _REST_IN] * 2
    width = 1.6 + 4.0 * len(series) + 0.8 * by_phase  # the taps' legend stands beside them
    figure = Figure(figsize=(width, sum(heights)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(heights), len(series), sharex=True, sharey="row", squeeze=False, height_ratios=heights)
    n_dc, dt = scenario.n_sites, scenario.dt_s
    for column, (name, run) in zip(axes.T, series.items(), strict=True):
        t = np.arange(len(run.v_pu)) * dt
        for ax, row in zip(column, rows, strict=False):
            row.draw(ax, run, t)
        column[0].set_title(f"{name}    J = {run.metrics()['J']:.3f}", fontsize=11)
        clock, backlog = column[-2:]
        for i in range(n_dc):
            colour = agent_colour(i)
            clock.step(t[1:], run.f_mhz[:, i], where="pre", color=colour, linewidth=1.2, label=f"dc_{i}")
            backlog.plot(t, run.backlog_kws[:, i], color=colour, linewidth=1.2)
        clock.set_ylim(0.0, 1.05 * scenario.datacenters.f_max_mhz)
        backlog.set_xlabel("time (s)")
        for ax in column:
            ax.grid(alpha=0.25, linewidth=0.6)
            ax.spines[["top", "right"]].set_visible(False)
    column = axes[:, 0]
    for ax, label in zip(column, (*(row.label for row in rows), "GPU clock (MHz)", "backlog (kW s)"), strict=True):
        ax.set_ylabel(label)
    for row, across in zip(rows, axes, strict=False):
        row.finish(across, list(series.values()))
    peak = max(float(run.backlog_kws.max(initial=0.0)) for run in series.values())
    column[-1].set_ylim(-0.02 * max(peak, 1.0), 1.05 * max(peak, 1.0))
    if 0 < n_dc <= MOST_NAMED:
        column[-2].legend(loc="lower right", fontsize=8, frameon=False, ncols=min(n_dc, 5))
    cut = "\n" if by_phase and len(series) == 1 else " "
    figure.suptitle(f"{scenario.name}, {scenario.split} split, seed {seed}:{cut}the same episode under each controller")
    return figure


def _balanced_rows(scenario: Scenario) -> list[Row]:
    def draw(ax: Axes, run: Series, t: np.ndarray) -> None:
        voltages(ax, scenario, run, t, scenario.feeder.load_nodes)

    def finish(across: np.ndarray, runs: list[Series]) -> None:
        fit_voltages(across[0], scenario, runs)
        across[0].legend(loc="upper right", fontsize=8, frameon=False, ncols=2, columnspacing=1.0)

    return [Row("voltage (p.u.)", 8.2 - 2 * _REST_IN, draw, finish)]
