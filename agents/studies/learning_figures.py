"""Figures of these studies: voltage against delay, and learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dcgrid_env.agents.studies.curves import Line
from dcgrid_env.agents.studies.pareto import Front, Learned
from dcgrid_env.baselines.benchmark.benchmark_figures import FRONT_COLOUR, REFERENCE_COLOUR, REST_COLOUR
from dcgrid_env.baselines.reproduction.drawing import new_figure, say
from dcgrid_env.baselines.score import REFERENCE

PANELS = (
    ("voltage_deviation_mean_pu", 1e3, "mean |V - 1| (0.001 p.u.)"),
    ("outside_bus_seconds_pct", 1.0, "bus-seconds outside the band (%)"),
    ("J_but_delay", 1.0, "J but for waiting"),
)
"""Metric, factor and name of each panel of the front; the last is what the policies are trained for."""
LINEAR_S = 0.1
"""Delay up to which the axis is linear, so that none has its place, s."""
DASHES = ("-", "--", ":")
MARKS = {REFERENCE: ("D", REFERENCE_COLOUR), "mpc-one-step": ("s", REST_COLOUR)}
COLOURS = ("#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours of Okabe and Ito; the reference has the one that is missing."""
ALONG = {"seconds": "training time (s)", "steps": "environment steps"}
MOST_COLUMNS, MOST_SHOWN_PCT = 4, 1000.0


def pareto_figure(front: Front) -> Figure:
    """The learned front over the droop law's curves, in mean deviation, time outside the band, and cost."""
    figure = new_figure(14.4, 5.0)
    axes = figure.subplots(1, len(PANELS))
    for ax, (metric, factor, name) in zip(axes, PANELS, strict=True):
        _front(ax, front, metric, factor)
        say(ax, "mean delay of work (s)", name)
        ax.set_xscale("symlog", linthresh=LINEAR_S, linscale=0.5)
        ticks = [t for t in (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0) if t <= 1.3 * ax.get_xlim()[1]]
        ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        ax.set_xlim(-0.3 * LINEAR_S, None)
        ax.minorticks_off()
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=3, fontsize=8.5, frameon=False)
    figure.suptitle(f"{front.scenario}, {front.episodes} test episodes: lower left is better", fontsize=11)
    return figure


def _front(ax: Axes, front: Front, metric: str, factor: float) -> None:
    for curve, dashes in zip(front.swept, DASHES, strict=False):
        x, y = (np.array([one.mean.means[key] for one in curve.tested]) for key in ("delay_mean_s", metric))
        label = f"droop, k_p swept, alpha {curve.alpha_per_s:g} /s" + " (tuned)" * curve.tuned
        ax.plot(x, factor * y, color=REFERENCE_COLOUR, linestyle=dashes, linewidth=1.3, marker=".", label=label)
    for name, one in front.points.items():
        mark, colour = MARKS[name]
        means = one.mean.means
        ax.plot(means["delay_mean_s"], factor * means[metric], linestyle="none", marker=mark, markersize=7,
                color=colour, markeredgecolor="white", zorder=4, label=name)  # fmt: skip
    limited = [one for one in front.learned if one.limit_s is not None]
    limited.sort(key=lambda one: one.tested.mean.means["delay_mean_s"])
    x, y = (np.array([one.tested.mean.means[key] for one in limited]) for key in ("delay_mean_s", metric))
    ax.plot(
        x, factor * y, color=FRONT_COLOUR, linewidth=1.8, marker="o", zorder=5, label="learned, under a limit on delay"
    )
    for i, one in enumerate(limited):
        ax.annotate(f"{one.limit_s:g} s", (x[i], factor * y[i]), xytext=(0, -13), textcoords="offset points",
                    ha="center", fontsize=7.5, color=FRONT_COLOUR)  # fmt: skip
        _seeds(ax, one, metric, factor)
    for one in front.learned:
        if one.limit_s is None:
            means = one.tested.mean.means
            ax.plot(means["delay_mean_s"], factor * means[metric], linestyle="none", marker="o", markersize=8,
                    markerfacecolor="white", markeredgecolor=FRONT_COLOUR, markeredgewidth=1.8, zorder=6,
                    label="learned, waiting priced as in J")  # fmt: skip
            _seeds(ax, one, metric, factor)


def _seeds(ax: Axes, one: Learned, metric: str, factor: float) -> None:
    """Each training seed as a dot where there are several."""
    if len(one.tested.each) > 1:
        means = [seed.means for seed in one.tested.each]
        x, y = ([m[key] for m in means] for key in ("delay_mean_s", metric))
        ax.plot(x, factor * np.array(y), linestyle="none", marker=".", markersize=4, color=FRONT_COLOUR, alpha=0.5)


def curves_figure(by_scenario: Mapping[str, Sequence[Line]], x: str = "seconds") -> Figure:
    """A panel for each scenario: what the validation cost saves against the tuned droop, along one of ``curves.X``."""
    columns = min(MOST_COLUMNS, len(by_scenario))
    rows = -(-len(by_scenario) // columns)
    figure = new_figure(1.0 + 3.4 * columns, 0.8 + 2.8 * rows)
    axes = figure.subplots(rows, columns, squeeze=False)
    labels = list(dict.fromkeys(line.label for every in by_scenario.values() for line in every))
    for ax, (scenario, every) in zip(axes.flat, by_scenario.items(), strict=False):
        for line in every:
            _curve(ax, line, labels.index(line.label))
        ax.axhline(0.0, color=REFERENCE_COLOUR, linewidth=1.1)
        say(ax, ALONG[x], "", scenario)
        _gain_axis(
            ax, min(float(line.low_pct.min()) for line in every), max(float(line.high_pct.max()) for line in every)
        )
        _log_axis(ax)
    for ax in list(axes.flat)[len(by_scenario) :]:
        ax.set_visible(False)
    handles = {label: handle for ax in axes.flat for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=6, fontsize=9, frameon=False)
    figure.supylabel(f"J on validation below that of {REFERENCE} (%)", fontsize=9.5)
    return figure


def _curve(ax: Axes, line: Line, order: int) -> None:
    look = {"color": COLOURS[order % len(COLOURS)], "linestyle": ("-", "--", "-.", ":")[order % 4]}
    ax.plot(line.x, line.mean_pct, **look, linewidth=1.7, label=line.label, zorder=3)  # pyright: ignore
    if line.x[0] == line.x[-1]:  # judged once
        ax.plot(line.x[:1], line.mean_pct[:1], marker="o", markersize=4, color=look["color"])
    if line.n_runs > 1:
        ax.fill_between(line.x, line.low_pct, line.high_pct, color=look["color"], alpha=0.22, linewidth=0)


def _gain_axis(ax: Axes, worst: float, best: float) -> None:
    """Linear as far below the droop as the best is above, logarithmic beyond: beginnings cost many times the droop."""
    linear = max(best, 1.0)
    bottom = max(worst, -MOST_SHOWN_PCT)
    low = max(bottom, -linear)
    ticks = [tick for tick in MaxNLocator(6).tick_values(low, linear) if low <= tick <= linear]
    ticks += [-tick for tick in _rounded(linear, -bottom, (1, 3)) if tick > 1.5 * linear]
    ax.set_yscale("symlog", linthresh=linear, linscale=1.5)
    ax.set_ylim(1.15 * bottom if bottom < -linear else bottom - 0.08 * linear, 1.1 * linear)
    ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.minorticks_off()


def _log_axis(ax: Axes) -> None:
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    high = max(high, 4.0 * low)
    ax.set_xlim(low, high)
    ticks = next((t for steps in ((1, 3), (1, 2, 5), (1, 2, 3, 5, 7)) if len(t := _rounded(low, high, steps)) > 2), [])
    ax.set_xticks(ticks, [_short(tick) for tick in ticks])
    ax.minorticks_off()


def _short(number: float) -> str:
    """A number as a label, thousands as k and millions as M."""
    for unit, letter in ((1e6, "M"), (1e3, "k")):
        if number >= unit:
            return f"{number / unit:g}{letter}"
    return f"{number:g}"


def _rounded(low: float, high: float, steps: Sequence[int]) -> list[float]:
    """Numbers between two above 0 that begin with one of these digits and go on with zeros."""
    one = [digit * 10.0**power for power in range(-3, 11) for digit in steps]
    return [value for value in one if low <= value <= high]
