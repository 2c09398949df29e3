"""The figure of a run: one episode under several controllers, side by side."""

from __future__ import annotations

from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dcgrid_env.engine.exogenous.forecast import forecast
from dcgrid_env.engine.record.episode_record import Series
from dcgrid_env.grid import ThreePhaseFeeder
from dcgrid_env.rendering.banded_figure import long_figure
from dcgrid_env.rendering.envelope import Envelope
from dcgrid_env.rendering.figure_rows import agent_rows, phase_rows, total_rows, voltage_row
from dcgrid_env.rendering.replay_course import agent_figures
from dcgrid_env.scenario.scenario import Scenario

MOST_STEPS = 6000
"""Steps up to which a line is drawn through each of them."""
ZOOM_S = 10.0
"""Seconds that are shown of an episode in steps below 1 s."""
CAPTION = (
    "J: mean cost per step, lower is better. It adds the weighted costs of voltage deviation, voltages outside the "
    "limits (dashed), waiting work and the scenario's other terms."
)

_LETTERS_AN_INCH = 14.0
"""Letters of the caption in an inch of the figure's width at most."""


class Event(NamedTuple):
    """A kind of event that the figure marks."""

    label: str
    marker: str
    colour: str


SAG = Event("sag", "v", "#E69F00")
TRIP = Event("trip", "x", "#D00000")
TAP_CHANGE = Event("tap change", "|", "#4D4D4D")


def run_figure(scenario: Scenario, series: dict[str, Series], seed: int) -> Figure:
    """Draw one episode under several controllers.

    Columns are controllers. The first rows show voltages, then power over the whole feeder, then figures of the agents.
    All columns share the axes of a row. Rows in which nothing changes are left out. Marks at the lower edge of the
    voltages show sags, trips and tap changes, and the caption counts them. An episode in steps below 1 s is shown for
    the ``ZOOM_S`` around the largest change of demand. Episodes of more than ``MOST_STEPS`` are drawn by
    ``long_figure``.

    Parameters
    ----------
    scenario
        The scenario of all episodes.
    series
        The recorded episode by the name of its controller.
    seed
        Seed of the episode.
    """
    if scenario.horizon > MOST_STEPS:
        return long_figure(scenario, {name: Envelope.from_series(run) for name, run in series.items()}, seed)
    by_phase = isinstance(scenario.feeder, ThreePhaseFeeder)
    runs = list(series.values())
    rows = [
        *(phase_rows(scenario, runs) if by_phase else [voltage_row(scenario)]),
        *total_rows(scenario, runs),
        *agent_rows(scenario, runs),
    ]
    heights = [row.height_in for row in rows]
    width = 1.6 + 4.0 * len(series) + 0.8 * by_phase  # the taps' legend is to the right of them
    figure = Figure(figsize=(width, 0.6 + sum(heights)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(rows), len(series), sharex=True, sharey="row", squeeze=False, height_ratios=heights)
    first, last = shown_s(scenario, runs)
    axes[0, 0].set_xlim(first, last)
    for column, (name, run) in zip(axes.T, series.items(), strict=True):
        t = np.arange(len(run.v_pu)) * scenario.dt_s
        for ax, row in zip(column, rows, strict=True):
            row.draw(ax, run, t)
            ax.grid(alpha=0.25, linewidth=0.6)
            ax.spines[["top", "right"]].set_visible(False)
        column[0].set_title(f"{name}    J = {run.metrics()['J']:.3f}", fontsize=11)
        column[-1].set_xlabel("time (s)")
    for row, across in zip(rows, axes, strict=True):
        across[0].set_ylabel(row.label)
        row.finish(across, runs)
    events = {name: _events(scenario, run, seed) for name, run in series.items()}
    _mark(axes[0], list(events.values()))
    shown = "" if last - first >= scenario.horizon * scenario.dt_s else f", {first:g} to {last:g} s"
    cut = "\n" if len(series) == 1 else " "
    figure.suptitle(
        f"{scenario.name}, {scenario.split} split, seed {seed}{shown}:{cut}the same episode under each controller"
    )
    caption = "\n".join(fill(line, int(_LETTERS_AN_INCH * width)) for line in [CAPTION, *_counts(events)])
    figure.supxlabel(caption, fontsize=8.5, color="#444444")
    return figure


def shown_s(scenario: Scenario, runs: list[Series]) -> tuple[float, float]:
    """Return the beginning and the end of what is shown, s."""
    length = scenario.horizon * scenario.dt_s
    if scenario.dt_s >= 1.0 or length <= 2.0 * ZOOM_S:
        return 0.0, length
    drawn = runs[0].p_kw.sum(axis=1)
    largest = int(np.abs(np.diff(drawn)).argmax()) * scenario.dt_s
    first = float(np.floor(np.clip(largest - 0.5 * ZOOM_S, 0.0, length - ZOOM_S)))
    return first, first + ZOOM_S


def _events(scenario: Scenario, run: Series, seed: int) -> dict[Event, np.ndarray]:
    """Return the time of each event by its kind, s; simultaneous events repeat it."""
    steps = np.arange(1, len(run.v_pu))
    on_grid: Any = [agent["on_grid_pct"] for agent in agent_figures(run) if "on_grid_pct" in agent]
    tripped = (np.diff(on_grid, axis=1) < 0.0) & (np.array(on_grid)[:, :-1] > 0.0) if on_grid else np.zeros((1, 0))
    trips = np.flatnonzero(tripped.T) // len(tripped) + 1
    sags = forecast(scenario, seed).sags
    phases = run.three_phase
    taps = steps[:0] if phases is None else steps.repeat(phases.equipment.regulators.moved[1:].sum(axis=1).astype(int))
    return {
        SAG: np.zeros(0) if sags is None else sags[:, 0],
        TRIP: trips * scenario.dt_s,
        TAP_CHANGE: taps * scenario.dt_s,
    }


def _counts(events: dict[str, dict[Event, np.ndarray]]) -> list[str]:
    """Return the caption's line on the number of events under each controller, if there are any."""
    kinds = [kind for kind in (SAG, TRIP, TAP_CHANGE) if any(len(of_run[kind]) for of_run in events.values())]
    by_kind = [f"{kind.label}s {', '.join(str(len(of_run[kind])) for of_run in events.values())}" for kind in kinds]
    where = f" ({', '.join(events)})" if len(events) > 1 else ""
    return [f"Events in the episode{where}: {'; '.join(by_kind)}."] if kinds else []


def _mark(across: np.ndarray, events: list[dict[Event, np.ndarray]]) -> None:
    """Mark the events of each episode at the lower edge of its axes, each kind in its own line."""
    kinds = [kind for kind in events[0] if any(len(of_run[kind]) for of_run in events)]
    for i, kind in enumerate(kinds):
        height = 0.04 + 0.07 * i
        for ax, of_run in zip(across, events, strict=True):
            times = np.unique(of_run[kind])
            ax.plot(
                times, np.full(len(times), height), kind.marker, color=kind.colour, markersize=6,
                markeredgewidth=1.0, transform=ax.get_xaxis_transform(),
            )  # fmt: skip
        across[-1].annotate(
            kind.label, (1.01, height), xycoords="axes fraction", va="center", fontsize=8, color=kind.colour
        )
