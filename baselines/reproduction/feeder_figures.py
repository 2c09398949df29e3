"""Figures of voltage: the step of Fig. 3, the map of Fig. 4, Figs. 5 and 6."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dcgrid_env.baselines.reproduction.drawing import COLOURS, LABELS, LOOKS, band, line, new_figure, say
from dcgrid_env.baselines.reproduction.levers import settled
from dcgrid_env.baselines.reproduction.load_figures import all_sites
from dcgrid_env.baselines.reproduction.load_step import SITE, STEP_LAWS, step_series
from dcgrid_env.baselines.reproduction.paper import PUBLISHED_BUSES
from dcgrid_env.baselines.reproduction.study_runs import BOTH, INVERTERS, NONE, Runs
from dcgrid_env.baselines.reproduction.table1 import LAWS
from dcgrid_env.rendering import INK, draw_feeder, positions

BUSES = (13, 85, 4, 46)
"""Buses of Fig. 6, those that the public code plots: two with a data centre and two without."""


def step_figure(runs: Runs) -> Figure:
    """Fig. 3: toy6, voltage at the data centre and its power under each law, load added at 20 s."""
    figure = new_figure(10.0, 4.2)
    voltage, power = figure.subplots(1, 2)
    for name, series in step_series(runs).items():
        t = np.arange(len(series.v_pu)) * series.scenario.dt_s
        label = LABELS[name] + (f" (k_p = {STEP_LAWS[name].k_p_mw_per_pu:g} MW/p.u.)" if name == "both" else "")
        voltage.plot(t, series.v_pu[:, series.scenario.feeder.index(SITE)], label=label, **line(name))
        power.step(t[1:], series.p_kw[:, 0], where="pre", **line(name))
    band(voltage)
    say(voltage, "time (s)", "voltage (p.u.)", f"bus {SITE}, the data centre: more load, lower voltage")
    say(power, "time (s)", "power (kW)", "the data centre's draw")
    voltage.set_ylim(0.945, 1.01)
    figure.legend(*voltage.get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure


def map_figure(runs: Runs) -> Figure:
    """Fig. 4: ieee123 with its inverters and the eight published data centres, at base load and full draw."""
    scenario = all_sites(runs)
    feeder = scenario.feeder
    figure = Figure(figsize=(10.0, 7.6))
    new = figure.add_axes((0.01, 0.11, 0.98, 0.86))
    at = [feeder.index(bus) for bus in PUBLISHED_BUSES]
    inverters = [feeder.index(bus) for bus in scenario.inverter_buses]
    v = settled(scenario, dict.fromkeys(PUBLISHED_BUSES, 280.0))
    drawn = draw_feeder(new, feeder, positions(feeder), v, at, inverters, band_pu=scenario.band_pu)
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
    names += [f"inv_{i} {bus}" for i, bus in enumerate(scenario.inverter_buses)]
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
        by_count = [runs.of(runs.setting.scenario(n), law) for n in runs.setting.counts]
        mean = [run.deviation_pu for run in by_count]
        spread = [run.mean("voltage_deviation_std_pu") for run in by_count]
        # Beside one another, so that the bars do not cover each other.
        ax.errorbar(counts + 0.06 * (i - 1.5), mean, yerr=spread, label=LABELS[name], capsize=3, **LOOKS[name])
    say(ax, "data centres", "mean |V - 1| (p.u.)", "bars: standard deviation over buses and time")
    ax.set_xticks(counts)
    ax.set_ylim(0.0, None)
    ax.legend(frameon=False, ncols=2, loc="upper left")
    ax.set_ylim(0.0, 1.25 * ax.get_ylim()[1])
    return figure


def four_buses(runs: Runs, seed: int) -> Figure:
    """Fig. 6: four buses over two minutes under no control, inverters only and both axes."""
    scenario = all_sites(runs)
    figure = new_figure(10.0, 6.0)
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for name, law in (("none", NONE), ("inverters", INVERTERS), ("both", BOTH)):
        series = runs.series(scenario, law, seed)
        t = np.arange(len(series.v_pu)) * scenario.dt_s
        for ax, bus in zip(axes.ravel(), BUSES, strict=True):
            ax.plot(t, series.v_pu[:, scenario.feeder.index(bus)], label=LABELS[name], **line(name))
    for ax, bus in zip(axes.ravel(), BUSES, strict=True):
        band(ax, scenario.band_pu)
        say(ax, "", "", f"bus {bus}" + (", data centre" if bus in PUBLISHED_BUSES else ""))
    for ax in axes[1]:
        ax.set_xlabel("time (s)")
    for ax in axes[:, 0]:
        ax.set_ylabel("voltage (p.u.)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure
