"""Learning curves out of training folders: the runs of one algorithm on one scenario are one line with its band."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dcgrid_env.agents import Card
from dcgrid_env.baselines.score import REFERENCE
from dcgrid_env.core.figure_axes import REFERENCE_COLOUR, label_axes, new_figure
from dcgrid_env.core.user_files import is_file, read_json, read_text

X = {"seconds": "seconds", "steps": "env_steps"}
"""What a curve may run along, with its column in curve.csv: training time, or steps of environments."""
POINTS = 200
"""Points of a line."""


@dataclass(frozen=True)
class Curve:
    """A run's validations."""

    scenario: str
    label: str
    """Algorithm, and the view where it is not the shared one."""
    seed: int
    x: np.ndarray
    """Training time, s, or steps of environments, (n,), rising."""
    gain_pct: np.ndarray
    """How far J lies below the tuned droop's, %, (n,)."""


@dataclass(frozen=True)
class Line:
    """The runs of one label together."""

    label: str
    x: np.ndarray
    """Training time, s, or steps of environments, (n,)."""
    mean_pct: np.ndarray
    """(n,), as the next two."""
    low_pct: np.ndarray
    high_pct: np.ndarray
    n_runs: int


def read(folder: Path, x: str = "seconds") -> Curve:
    """A training folder's curve along one of ``X``; ValueError, naming file and fault, where it has none."""
    path = folder / "curve.csv"
    if not is_file(path, ValueError):
        raise ValueError(f"{folder}: there is no curve.csv; give the folder of a training run (dcgrid train)")
    rows = list(csv.DictReader(read_text(path, ValueError).splitlines()))
    along, j, j_droop = (_column(path, rows, name) for name in (X[x], "J", "J_droop"))
    measured = np.isfinite(j) & np.isfinite(j_droop) & np.isfinite(along)
    if not measured.any():
        raise ValueError(f"{path}: holds no validation yet; train on")
    card, view = Card.load(folder / "policy.json"), _policy_kind(folder / "config.json")
    label = card.algorithm if view in ("", "shared") else f"{card.algorithm}, {view}"
    gain_pct = 100.0 * (1.0 - j[measured] / j_droop[measured])
    return Curve(card.scenario, label, card.seed or 0, along[measured], gain_pct)


def _column(path: Path, rows: Sequence[Mapping[str, str | None]], name: str) -> np.ndarray:
    try:
        return np.array([float(row[name] or "nan") for row in rows])
    except (KeyError, ValueError) as error:
        raise ValueError(
            f"{path}: column {name} is missing or holds no figures ({error}); give a run that records it"
        ) from None


def _policy_kind(path: Path) -> str:
    try:
        return str(read_json(path, ValueError, "train again").get("view", ""))
    except (OSError, ValueError, AttributeError):
        raise ValueError(f"{path}: is no configuration of a training run; train again") from None


def lines(curves: Sequence[Curve]) -> dict[str, list[Line]]:
    """By scenario a line for each label, in the order in which they are given; ValueError for a seed given twice."""
    groups: dict[tuple[str, str], list[Curve]] = {}
    for curve in curves:
        groups.setdefault((curve.scenario, curve.label), []).append(curve)
    by_scenario: dict[str, list[Line]] = {}
    for (scenario, label), runs in groups.items():
        seeds = [run.seed for run in runs]
        twice = next((seed for seed in seeds if seeds.count(seed) > 1), None)
        if twice is not None:
            raise ValueError(f"folders: seed {twice} of {label} on {scenario} is there twice; give each run once")
        by_scenario.setdefault(scenario, []).append(_line(label, runs))
    return by_scenario


def _line(label: str, runs: Sequence[Curve]) -> Line:
    """Mean, lowest and highest from where all runs have been judged until the first of them ends.

    Between validations a run is as good as at the last.
    """
    begin, end = max(run.x[0] for run in runs), min(run.x[-1] for run in runs)
    x = runs[0].x if len(runs) == 1 else np.geomspace(max(begin, 1e-3), max(begin, end), POINTS)
    gains_pct = [run.gain_pct[np.searchsorted(run.x, x, side="right").clip(1) - 1] for run in runs]
    every = np.array(gains_pct)
    return Line(label, x, every.mean(axis=0), every.min(axis=0), every.max(axis=0), len(runs))


COLOURS = ("#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours of Okabe and Ito; the reference has the one that is missing."""
ALONG = {"seconds": "training time (s)", "steps": "environment steps"}
MOST_COLUMNS, MOST_SHOWN_PCT = 4, 1000.0


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
        label_axes(ax, ALONG[x], "", scenario)
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
