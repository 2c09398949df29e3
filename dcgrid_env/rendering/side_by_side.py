"""The figure of a run: one episode under several controllers, voltages, clocks and backlog over time."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dcgrid_env.engine.metrics import Series
from dcgrid_env.rendering.feeder_map import agent_colour
from dcgrid_env.rendering.history import node_words
from dcgrid_env.scenario.scenario import Scenario

MOST_NAMED = 10
"""Data centres up to which a figure names each; beyond, colours have repeated and a legend would hide the curves."""


def run_figure(scenario: Scenario, series: dict[str, Series], seed: int) -> Figure:
    """Columns are controllers; rows are voltages, clocks and backlog, each on one scale for all."""
    figure = Figure(figsize=(1.6 + 4.0 * len(series), 8.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3, len(series), sharex=True, sharey="row", squeeze=False)
    n_dc, dt = scenario.n_sites, scenario.dt_s
    for column, (name, run) in zip(axes.T, series.items(), strict=True):
        t = np.arange(len(run.v_pu)) * dt
        _voltages(column[0], scenario, run, t)
        column[0].set_title(f"{name}    J = {run.metrics()['J']:.3f}", fontsize=11)
        for i in range(n_dc):
            colour = agent_colour(i)
            column[1].step(t[1:], run.f_mhz[:, i], where="pre", color=colour, linewidth=1.2, label=f"dc_{i}")
            column[2].plot(t, run.backlog_kws[:, i], color=colour, linewidth=1.2)
        column[1].set_ylim(0.0, 1.05 * scenario.f_max_mhz)
        column[2].set_xlabel("time (s)")
        for ax in column:
            ax.grid(alpha=0.25, linewidth=0.6)
            ax.spines[["top", "right"]].set_visible(False)
    lowest = min(float(run.v_pu.min()) for run in series.values())
    axes[0, 0].set_ylim(min(lowest, 1.0 - scenario.band_pu) - 0.01, 1.0 + 1.9 * scenario.band_pu)  # room for the legend
    column = axes[:, 0]
    for ax, label in zip(column, ("voltage (p.u.)", "GPU clock (MHz)", "backlog (kW s)"), strict=True):
        ax.set_ylabel(label)
    peak = max(float(run.backlog_kws.max(initial=0.0)) for run in series.values())
    column[2].set_ylim(-0.02 * max(peak, 1.0), 1.05 * max(peak, 1.0))
    column[0].legend(loc="upper right", fontsize=8, frameon=False, ncols=2, columnspacing=1.0)
    if 0 < n_dc <= MOST_NAMED:
        column[1].legend(loc="lower right", fontsize=8, frameon=False, ncols=min(n_dc, 5))
    figure.suptitle(f"{scenario.name}, {scenario.split} split, seed {seed}: the same episode under each controller")
    return figure


def _voltages(ax, scenario: Scenario, run: Series, t: np.ndarray) -> None:
    feeder = scenario.feeder
    one, many = node_words(feeder)
    v = run.v_pu[:, feeder.load_slice]
    for share, alpha in ((0, 0.16), (10, 0.22), (25, 0.30)):
        low, high = np.percentile(v, [share, 100 - share], axis=1)
        label = {0: f"all {many}", 25: "middle half"}.get(share)
        ax.fill_between(t, low, high, color="#0072B2", alpha=alpha, linewidth=0, label=label)
    ax.plot(t, np.median(v, axis=1), color="#003f63", linewidth=1.4, label=f"median {one}")
    worst = int(np.argmin(v.min(axis=0)))
    lowest = feeder.node_ids[feeder.load_nodes[worst]]
    ax.plot(t, v[:, worst], color="#D55E00", linewidth=1.2, label=f"lowest: {one} {lowest}")
    for edge in (1.0 - scenario.band_pu, 1.0 + scenario.band_pu):
        ax.axhline(edge, color="black", linestyle="--", linewidth=0.9)
    ax.axhline(1.0, color="black", linewidth=0.5, alpha=0.5)
