"""Figure of a long run: bands over a few hundred intervals instead of a line through every step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from dcgrid_env.rendering.envelope import Envelope
from dcgrid_env.rendering.feeder_map import agent_colour
from dcgrid_env.rendering.history import node_words
from dcgrid_env.rendering.phase_curves import UNBALANCE, tap_looks
from dcgrid_env.scenario.scenario import Scenario

_MOST_NAMED = 10
_TICKS_H = (1 / 60, 1 / 30, 1 / 12, 1 / 6, 0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 12.0, 24.0, 48.0, 168.0)
_MOST_TICKS = 9


class _Row(NamedTuple):
    label: str
    height_in: float
    draw: Callable[[Axes, Envelope, np.ndarray], None]
    limits: Callable[[list[Envelope]], tuple[float | None, float | None]]


def long_figure(scenario: Scenario, envelopes: dict[str, Envelope], seed: int) -> Figure:
    """Columns are controllers; rows are voltages, what sites draw, clocks, backlog, and what else there is.

    A band runs from the lowest to the highest value within an interval, so that no peak is lost; a line is a mean over
    several, so that it is one.
    """
    first = next(iter(envelopes.values()))
    rows = _rows(scenario, first)
    width, height = 1.2 + 5.6 * len(envelopes), 0.9 + sum(row.height_in for row in rows)
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    heights = [row.height_in for row in rows]
    axes = figure.subplots(len(rows), len(envelopes), sharex=True, sharey="row", squeeze=False, height_ratios=heights)
    per_unit_s, unit = _time_unit(scenario)
    for column, (name, envelope) in zip(axes.T, envelopes.items(), strict=True):
        t = envelope.t_s / per_unit_s
        for ax, row in zip(column, rows, strict=True):
            row.draw(ax, envelope, t)
            ax.grid(alpha=0.25, linewidth=0.6)
            ax.spines[["top", "right"]].set_visible(False)
        column[0].set_title(f"{name}    J = {envelope.cost:.3f}", fontsize=11)
        column[-1].set_xlabel(f"time since the reset ({unit})")
        for ax in column[: len(first.groups)]:
            _mark_lowest(ax, scenario, envelope, per_unit_s, unit)
    for across, row in zip(axes, rows, strict=True):
        across[0].set_ylabel(row.label)
        across[0].set_ylim(*row.limits(list(envelopes.values())))
    length = scenario.horizon * scenario.dt_s / per_unit_s
    axes[-1, 0].set_xlim(0.0, length)
    axes[-1, 0].xaxis.set_major_locator(MultipleLocator(_tick(length, unit)))
    axes[0, 0].legend(loc="upper right", fontsize=8, frameon=False, ncols=3, columnspacing=1.0)
    each_s = scenario.dt_s * first.steps_each
    figure.suptitle(
        f"{scenario.name}, {scenario.split} split, seed {seed}: the same episode of {scenario.horizon:,} steps under "
        f"each controller\nbands: lowest to highest value of every {_length(each_s)}; "
        f"lines: means of every {_length(each_s * first.intervals_a_mean)}",
        fontsize=11,
    )
    return figure


def _length(span_s: float) -> str:
    return next(
        (f"{span_s / per:.3g} {unit}" for per, unit in ((3600.0, "h"), (60.0, "min")) if span_s >= per),
        f"{span_s:.3g} s",
    )


def _time_unit(scenario: Scenario) -> tuple[float, str]:
    length_s = scenario.horizon * scenario.dt_s
    if length_s >= 4.0 * 86400.0:
        return 86400.0, "days"
    return (3600.0, "h") if length_s >= 2.0 * 3600.0 else (60.0, "min")


def _tick(length: float, unit: str) -> float:
    per_h = {"days": 24.0, "h": 1.0, "min": 1.0 / 60.0}[unit]
    spaces = [tick_h / per_h for tick_h in _TICKS_H if tick_h >= per_h or unit != "days"]
    return next((space for space in spaces if length / space <= _MOST_TICKS), spaces[-1])


def _rows(scenario: Scenario, envelope: Envelope) -> list[_Row]:
    n_sites = scenario.n_sites
    rows = [_voltages(scenario, name, 3.0 if not name else 1.9) for name in envelope.groups]
    if envelope.curves("unbalance_pct") is not None:
        rows.append(_lines("V2 / V1 (%)", "unbalance_pct", [UNBALANCE], 1.4))
    if (taps := envelope.curves("tap")) is not None and np.ptp(taps.high - taps.low) > 0.0:
        rows.append(_lines("taps", "tap", list(tap_looks(scenario.feeder)["colors"]), 1.6, from_zero=False))
    if (stored := envelope.curves("stored_pct")) is not None:
        rows.append(_lines("stored (%)", "stored_pct", _colours(stored.mean.shape[1]), 1.6))
    if n_sites:
        rows += [
            _lines("drawn by sites (kW)", "drawn_kw", ["#1A1A1A"], 1.5),
            _lines(
                "GPU clock (MHz)",
                "f_mhz",
                _colours(n_sites),
                1.9,
                top=1.05 * scenario.datacenters.f_max_mhz,
                prefix="dc",
            ),
            _lines("backlog (kW s)", "backlog_kws", _colours(n_sites), 1.9),
        ]
    return rows


def _colours(n: int) -> list[Any]:
    return [agent_colour(i) for i in range(n)]


def _voltages(scenario: Scenario, phase: str, height_in: float) -> _Row:
    many = node_words(scenario.feeder)[1]

    def draw(ax: Axes, run: Envelope, t: np.ndarray) -> None:
        v = run.spread(f"v{phase}")
        ax.fill_between(t, v.low, v.high, color="#0072B2", linewidth=0, alpha=0.18, label=f"all {many}")
        lower, middle, upper = v.quartiles.T
        ax.fill_between(t, lower, upper, color="#0072B2", linewidth=0, alpha=0.40, label="middle half")
        ax.plot(t, middle, color="#003f63", linewidth=1.1, label="median")
        for edge in (1.0 - scenario.cost.band_pu, 1.0 + scenario.cost.band_pu):
            ax.axhline(edge, color="black", linestyle="--", linewidth=0.9)
        ax.axhline(1.0, color="black", linewidth=0.5, alpha=0.5)

    def limits(runs: list[Envelope]) -> tuple[float, float]:
        spreads = [run.spread(f"v{phase}") for run in runs]
        low, high = min(float(v.low.min()) for v in spreads), max(float(v.high.max()) for v in spreads)
        band = scenario.cost.band_pu
        return min(low, 1.0 - band) - 0.02, max(high, 1.0 + band) + 0.5 * band

    return _Row(f"phase {phase} (p.u.)" if phase else "voltage (p.u.)", height_in, draw, limits)


def _mark_lowest(ax: Axes, scenario: Scenario, run: Envelope, per_unit_s: float, unit: str) -> None:
    """Point at the lowest voltage of the episode, on the axes that have its node."""
    v_pu, node, at_s = run.lowest
    names = [scenario.feeder.node_ids[i] for i in list(run.groups.values())[ax.get_subplotspec().rowspan.start]]  # pyright: ignore
    if node not in names:
        return
    time = at_s / per_unit_s
    ax.plot([time], [v_pu], marker="^", markersize=6, color="#D55E00", clip_on=False, zorder=5)
    late = time > 0.6 * scenario.horizon * scenario.dt_s / per_unit_s
    ax.annotate(
        f"lowest: {v_pu:.3f} at {node_words(scenario.feeder)[0]} {node}, {time:.2f} {unit}",
        (time, v_pu), xytext=(-8 if late else 8, -2), textcoords="offset points", fontsize=8, color="#A34700",
        ha="right" if late else "left", va="center",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1},
    )  # fmt: skip


def _lines(
    label: str,
    name: str,
    colours: list[Any],
    height_in: float,
    top: float | None = None,
    from_zero: bool = True,
    prefix: str = "",
) -> _Row:
    """A band for all that have the figure, and the mean of each."""

    def draw(ax: Axes, run: Envelope, t: np.ndarray) -> None:
        curves = run.curves(name)
        if curves is None:
            return
        n = curves.mean.shape[1]
        if name != "tap":  # levels of their own each
            ax.fill_between(
                t, curves.low.min(axis=1), curves.high.max(axis=1), color="#9A9A9A", linewidth=0, alpha=0.35
            )
        begin = np.arange(0, len(t), run.intervals_a_mean)
        counts = np.diff(np.append(begin, len(t)))
        middle, mean = (np.add.reduceat(x, begin, axis=0) / counts[:, None] for x in (t[:, None], curves.mean))
        for i, colour in enumerate(colours):
            called = f"{prefix}_{i}" if prefix and n <= _MOST_NAMED else None
            ax.plot(middle[:, 0], mean[:, i], color=colour, linewidth=1.3, label=called)
        if prefix and n <= _MOST_NAMED and ax.get_subplotspec().is_first_col():  # pyright: ignore
            ax.legend(loc="lower right", fontsize=8, frameon=False, ncols=min(n, 5))

    def limits(runs: list[Envelope]) -> tuple[float | None, float | None]:
        if top is not None:
            return 0.0, top
        if not from_zero:
            return None, None
        peak = max((float(curves.high.max(initial=0.0)) for run in runs if (curves := run.curves(name))), default=0.0)
        return -0.02 * max(peak, 1.0), 1.06 * max(peak, 1.0)

    return _Row(label, height_in, draw, limits)
