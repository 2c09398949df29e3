"""Figures of voltage: the step of Fig. 3, the map of Fig. 4, Figs. 5 and 6."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dcgrid_env import Scenario
from dcgrid_env.apps.reproduction.levers import settled
from dcgrid_env.apps.reproduction.load_step import CHANGES, SITE, STEP_AT, STEP_LAWS, step_series
from dcgrid_env.apps.reproduction.paper import PUBLISHED_BUSES
from dcgrid_env.apps.reproduction.study_runs import BOTH, INVERTERS, NO_CONTROL, Runs
from dcgrid_env.apps.reproduction.table1 import LAWS
from dcgrid_env.core.figure_axes import label_axes, new_figure
from dcgrid_env.rendering import INK, draw_feeder, positions
from docs.studies.paper.drawing import COLOURS, LABELS, LOOKS, band, line
from docs.studies.paper.load_figures import all_sites

BUSES = {13: "data centre", 25: "data centre", 85: "load", 4: "inverter"}
"""Buses of Fig. 6 as the paper has them."""
FIGURE_6_SITES = (13, 25, 28, 37, 53)
"""Data centres of Fig. 6: the two that it shows, the others from the public code."""
FIGURE_6_INVERTERS = (4, 11, 40, 54, 87, 92, 103)
"""Inverters of Fig. 6: those of the scenario, one moved from bus 2 to bus 4."""


def step_figure(runs: Runs) -> Figure:
    """Fig. 3: toy6, voltage at the data centre under each law, its load coming, and its load going, at 20 s."""
    figure = new_figure(10.0, 4.2)
    axes = figure.subplots(1, 2, sharey=True)
    for ax, change in zip(axes, CHANGES, strict=True):
        for name, series in step_series(runs, change).items():
            t = np.arange(len(series.v_pu)) * series.scenario.dt_s
            label = LABELS[name] + (f" (k_p = {STEP_LAWS[name].k_p_mw_per_pu:g} MW/p.u.)" if name == "both" else "")
            ax.plot(t, series.v_pu[:, series.scenario.feeder.index(SITE)], label=label, **line(name))
        band(ax)
        ax.axvline(STEP_AT, color="black", linewidth=0.5, alpha=0.5)
        title = f"2.5 MW at bus {SITE} {'come on' if change == 'comes' else 'go off'} at {STEP_AT} s"
        label_axes(ax, "time (s)", "", title)
    axes[0].set_ylabel("voltage at the data centre (p.u.)")
    axes[0].set_ylim(0.945, 1.01)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure


def map_figure(runs: Runs) -> Figure:
    """Fig. 4: ieee123 with its inverters and the eight published data centres, at base load and full draw."""
    scenario = all_sites(runs)
    feeder = scenario.feeder
    figure = Figure(figsize=(10.0, 7.6))
    new = figure.add_axes((0.01, 0.11, 0.98, 0.86))
    sites = [feeder.index(bus) for bus in PUBLISHED_BUSES]
    inverters = [feeder.index(bus) for bus in scenario.inverters.buses]
    v = settled(scenario, dict.fromkeys(PUBLISHED_BUSES, 280.0))
    drawn = draw_feeder(new, feeder, positions(feeder), v, sites, inverters, band_pu=scenario.cost.band_pu)
    bar = figure.colorbar(drawn.dots, cax=figure.add_axes((0.06, 0.07, 0.4, 0.018)), orientation="horizontal")
    bar.set_label("voltage (p.u.), no control; ringed: outside the band")
    look: dict[str, Any] = {"linestyle": "none", "markerfacecolor": "white"}
    handles = [
        Line2D([], [], marker=marker, markersize=size, label=label, markeredgecolor=edge, **look)
        for marker, size, label, edge in (
            ("s", 8, f"substation ({feeder.bus_ids[0]})", INK),
            ("^", 8, "inverter", INK),
            ("o", 12, "data centre", COLOURS[0]),
        )
    ]
    figure.legend(handles=handles, loc=(0.52, 0.035), ncols=3, frameon=False)
    names = [*(f"dc_{i} {bus}" for i, bus in enumerate(PUBLISHED_BUSES))]
    names += [f"inv_{i} {bus}" for i, bus in enumerate(scenario.inverters.buses)]
    half = (len(names) + 1) // 2
    figure.text(0.53, 0.005, "buses: " + ", ".join(names[:half]) + ",\n" + ", ".join(names[half:]), fontsize=7.5)
    return figure


def against_number(runs: Runs) -> Figure:
    """Fig. 5: mean abs(V - 1) and its standard deviation under each law, against the number of data centres."""
    figure = new_figure(8.6, 4.8)
    ax = figure.subplots()
    counts = np.array(runs.setting.counts)
    for i, (name, law) in enumerate(LAWS.items()):
        if name == "both-one-step":
            continue  # at k_p = 1 it lies on the cumulative form
        by_count = [runs.run(runs.setting.scenario(n), law) for n in runs.setting.counts]
        mean = [run.deviation_pu for run in by_count]
        spread = [run.mean("voltage_deviation_std_pu") for run in by_count]
        # Beside one another, so that the bars do not cover each other.
        ax.errorbar(counts + 0.06 * (i - 1.5), mean, yerr=spread, label=LABELS[name], capsize=3, **LOOKS[name])
    label_axes(ax, "data centres", "mean |V - 1| (p.u.)", "bars: standard deviation over buses and time")
    ax.set_xticks(counts)
    ax.set_ylim(0.0, None)
    ax.legend(frameon=False, ncols=2, loc="upper left")
    ax.set_ylim(0.0, 1.25 * ax.get_ylim()[1])
    return figure


def figure_six(runs: Runs) -> Scenario:
    """The scenario of Fig. 6."""
    return runs.setting.pinned(FIGURE_6_SITES, inverters={"buses": FIGURE_6_INVERTERS})


def four_buses(runs: Runs, seed: int) -> Figure:
    """Fig. 6: four buses over two minutes under no control, inverters only and both axes."""
    scenario = figure_six(runs)
    figure = new_figure(10.0, 6.0)
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for name, law in (("none", NO_CONTROL), ("inverters", INVERTERS), ("both", BOTH._replace(k_p_mw_per_pu=10.0))):
        series = runs.series(scenario, law, seed)
        t = np.arange(len(series.v_pu)) * scenario.dt_s
        for ax, bus in zip(axes.ravel(), BUSES, strict=True):
            ax.plot(t, series.v_pu[:, scenario.feeder.index(bus)], label=LABELS[name], **line(name))
    for ax, (bus, what) in zip(axes.ravel(), BUSES.items(), strict=True):
        band(ax, scenario.cost.band_pu)
        label_axes(ax, "", "", f"bus {bus}, {what}")
    for ax in axes[1]:
        ax.set_xlabel("time (s)")
    for ax in axes[:, 0]:
        ax.set_ylabel("voltage (p.u.)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure
