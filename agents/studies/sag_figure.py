"""The figure of the recorded sags: a column for each controller, who is on the grid above, the voltage below."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dcgrid_env.agents.studies.sag_study import Driven, SagStudy
from dcgrid_env.baselines.hindsight_costs import BEST_KNOWN
from dcgrid_env.baselines.reproduction.drawing import new_figure

SITES = ("#0072B2", "#56B4E9", "#009E73", "#CC79A7")
PV, VOLTAGE, WRONG = "#E69F00", "#444444", "#D55E00"
TITLES = {"none": "no control", BEST_KNOWN: "best known (no bound)"}
HIGH_PU, LOW_PU = 1.10, 0.90
"""Beyond these inverters and sites trip."""


def sag_figure(study: SagStudy) -> Figure:
    """Draw of the sites, PV and voltage over one episode, under each controller."""
    columns = len(study.driven)
    figure = new_figure(3.0 * columns + 0.8, 7.4)
    axes = figure.subplots(3, columns, sharex=True, sharey="row", squeeze=False, height_ratios=(3, 1.3, 3.2))
    for column, one in enumerate(study.driven):
        _load(axes[0, column], one)
        _pv(axes[1, column], one)
        _voltage(axes[2, column], one)
        for ax in axes[:, column]:
            for begin_s in study.sag_s:
                ax.axvline(begin_s, color="black", linestyle=(0, (3, 3)), linewidth=0.8, alpha=0.6)
            ax.spines[["top", "right"]].set_visible(False)
            ax.set_xlim(0.0, one.course.time_s[-1])
        axes[2, column].set_xlabel("time (s)")
    low, high = axes[2, 0].get_ylim()
    axes[2, 0].set_ylim(low, high + 0.2 * (high - low))  # room for what is said there
    for row, label in zip(axes, ("sites on the grid (kW)", "PV (kW)", "voltage (p.u.)"), strict=True):
        row[0].set_ylabel(label)
    handles, names = axes[0, 0].get_legend_handles_labels()
    more, further = axes[2, 0].get_legend_handles_labels()
    figure.legend([*handles, *more], [*names, *further], loc="outside lower center", ncols=8, frameon=False, fontsize=9)
    figure.suptitle(
        f"Six dips of 50 ms within 82 s (dashed): who leaves the feeder, and what its voltage does  |  "
        f"{study.scenario.name}, test episode {study.seed}",
        fontsize=12,
    )
    return figure


def _load(ax: Axes, one: Driven) -> None:
    course, figures = one.course, one.course.figures
    names = [f"site {i + 1}" for i in range(course.sites_kw.shape[1])]
    ax.stackplot(course.time_s, course.sites_kw.T, labels=names, colors=SITES, linewidth=0, step="pre")
    ax.set_ylim(0.0, None)
    said = (
        f"{figures['ups_trips']:.0f} trips, {figures['ups_lost_kw']:.0f} kW lost in all\n"
        f"all back after {figures['ups_all_back_s']:.0f} s"
    )
    ax.set_title(TITLES.get(one.name, one.name), fontsize=12.5, fontweight="bold", pad=36)
    ax.text(0.5, 1.02, said, transform=ax.transAxes, ha="center", va="bottom", fontsize=10.5)


def _pv(ax: Axes, one: Driven) -> None:
    ax.fill_between(one.course.time_s, one.course.pv_kw, color=PV, linewidth=0, step="pre")
    ax.set_ylim(0.0, None)
    trips = one.course.figures["inverter_trips"]
    said = f"{trips:.0f} inverters trip" if trips else "no inverter trips"
    frame = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    ax.text(0.98, 0.06, said, transform=ax.transAxes, ha="right", fontsize=10, bbox=frame,
            color=WRONG if trips else "black", fontweight="bold" if trips else "normal")  # fmt: skip


def _voltage(ax: Axes, one: Driven) -> None:
    course = one.course
    t, low, high = course.time_s, course.v_low_pu, course.v_high_pu
    ax.fill_between(t, low, high, color=VOLTAGE, alpha=0.35, linewidth=0, step="pre", label="lowest to highest voltage")
    ax.fill_between(t, HIGH_PU, high, where=high > HIGH_PU, color=WRONG, linewidth=0, step="pre",
                    label="above 1.10 or below 0.90: timers of trips run")  # fmt: skip
    ax.fill_between(t, low, LOW_PU, where=low < LOW_PU, color=WRONG, linewidth=0, step="pre")
    for edge in (LOW_PU, HIGH_PU):
        ax.axhline(edge, color=WRONG, linewidth=0.9)
    ax.axhline(1.0, color="black", linewidth=0.5, alpha=0.5)
    ax.text(0.98, 0.97, f"{low.min():.3f} to {high.max():.3f} p.u.", transform=ax.transAxes, ha="right", va="top",
            fontsize=10)  # fmt: skip
