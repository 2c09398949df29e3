"""Figures of the benchmark: scores, voltage against delay, voltage distributions, and an episode replayed.

Colours distinguish the reference, controllers on the Pareto front, and the rest. They differ under the common kinds of
colour blindness. Names are next to the points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dcgrid_env.apps.benchmark.jobs import V_EDGES_PU, Case
from dcgrid_env.apps.benchmark.summary import ScenarioSummary, Summary, by_use
from dcgrid_env.baselines import rollout
from dcgrid_env.baselines.rollout import ControllerError
from dcgrid_env.baselines.score import REFERENCE
from dcgrid_env.baselines.user_code import described
from dcgrid_env.core.figure_axes import FRONT_COLOUR, REFERENCE_COLOUR, REST_COLOUR, new_figure
from dcgrid_env.core.html_page import png
from dcgrid_env.rendering import run_figure

NAME_LENGTH = 28
LABEL_HEIGHT_IN, OTHER_HEIGHT_IN = 0.17, 1.1
"""Height of a name next to a point, and of the figure without its axes, inches."""


@dataclass(frozen=True)
class Replay:
    """Episodes of a scenario to repeat and draw, each under all of the controllers."""

    case: Case
    costliest: Mapping[str, int]
    """Seed of the costliest episode of each of the controllers."""

    @property
    def seeds(self) -> tuple[int, ...]:
        """Each episode once."""
        return tuple(dict.fromkeys(self.costliest.values()))


@dataclass(frozen=True)
class Sheet:
    """What is drawn of a scenario where not every controller failed."""

    summary: ScenarioSummary
    voltages: Mapping[str, np.ndarray]
    """Counts, see :func:`scenario_figure`."""
    worst: Replay


@dataclass(frozen=True)
class Drawn:
    """A sheet's figures."""

    scenario: bytes
    """PNG."""
    worst: tuple[bytes, ...] | str
    """A PNG for each of the replayed seeds, or why there is none."""


def draw(sheet: Sheet) -> Drawn:
    """The figures of a scenario."""
    band_pu = sheet.worst.case.scenario().cost.band_pu
    return Drawn(png(scenario_figure(sheet.summary, sheet.voltages, band_pu)), replay(sheet.worst))


def replay(task: Replay) -> tuple[bytes, ...] | str:
    """Each episode as a PNG, or why there is none."""
    scenario = task.case.scenario()
    runs = {}
    for name in task.costliest:
        try:
            runs[short(name)] = rollout(scenario, task.case.controller(name), task.seeds, name=name)
        except ControllerError as error:
            return f"{name} failed when this was run again, in {error.where}: {error.reason}"
        except (Exception, SystemExit) as error:  # in a batch it worked; the user's code, so anything
            return f"{name} failed when this was run again: {described(error)}"
    return tuple(
        png(run_figure(scenario, {name: recorder.series(i) for name, recorder in runs.items()}, seed), dpi=80)
        for i, seed in enumerate(task.seeds)
    )


def short(name: str) -> str:
    """A controller's name as figures write it: the end of a long path, and no mathematics."""
    cut = name if len(name) <= NAME_LENGTH else "…" + name[1 - NAME_LENGTH :]
    return cut.replace("$", r"\$")


def pareto_front(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Which points no other beats in one figure without losing in the other, bool, (n,); less is better in both."""
    points = np.column_stack((first, second))
    no_worse = (points[:, None] <= points[None]).all(axis=-1)
    better = (points[:, None] < points[None]).any(axis=-1)
    return np.asarray(~(no_worse & better).any(axis=0))


def score_figure(summaries: Sequence[ScenarioSummary]) -> Figure | None:
    """A panel for each scenario that has scores; None if there is none."""
    scored = [s for s in summaries if s.no_score is None]
    if not scored:
        return None
    names, _ = by_use(summaries)
    columns = min(4, len(scored))
    rows = -(-len(scored) // columns)
    figure = new_figure(2.4 + 2.7 * columns, rows * (0.9 + 0.24 * len(names)))
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for ax, summary in zip(axes.flat, scored, strict=False):
        _scores(ax, {row.controller: row for row in summary.working}, names)
        ax.set_title(summary.scenario, fontsize=10)
    for ax in list(axes.flat)[len(scored) :]:
        ax.set_visible(False)
    axes[0, 0].set_ylim(len(names) - 0.4, -0.6)
    figure.supxlabel(f"score with 95 % interval (0: {REFERENCE}, 1: perfect foresight)", fontsize=9)
    return figure


def _scores(ax: Axes, rows: Mapping[str, Summary], names: Sequence[str]) -> None:
    ax.axvline(0.0, color=REFERENCE_COLOUR, linewidth=1.0)
    ax.axvline(1.0, color=FRONT_COLOUR, linewidth=1.0, linestyle="--")
    values = [row.score.value for row in rows.values() if row.score]
    left = max(min(0.0, *values, *[row.score.low for row in rows.values() if row.score]), -1.5)
    ax.set_xlim(left - 0.12, 1.12)
    for y, name in enumerate(names):
        score = rows[name].score if name in rows else None
        if score is None:
            ax.text(left, y, "no result", fontsize=7, color=REST_COLOUR, va="center")
        elif score.value < left:
            ax.plot(left, y, marker="<", color=REST_COLOUR, markersize=5)
            ax.text(left + 0.08, y, f"{score.value:.1f}", fontsize=7, color=REST_COLOUR, va="center")
        else:
            colour = REFERENCE_COLOUR if name == REFERENCE else "black"
            ax.plot([score.low, score.high], [y, y], color=colour, linewidth=1.6, solid_capstyle="butt")
            ax.plot(score.value, y, marker="o", color=colour, markersize=4.5)
    ax.set_yticks(range(len(names)), [short(name) for name in names], fontsize=8)
    ax.tick_params(axis="x", labelsize=8)
    _without_spines(ax)


def scenario_figure(summary: ScenarioSummary, voltages: Mapping[str, np.ndarray], band_pu: float) -> Figure:
    """Voltage against delay, and where the voltages lie.

    ``voltages`` holds, for each controller that did not fail, counts in the bins of ``jobs.V_EDGES_PU``.
    """
    rows = summary.working
    height_in = max(4.4, 1.2 + 0.36 * len(rows))
    figure = new_figure(12.6, height_in)
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    _pareto(left, rows, LABEL_HEIGHT_IN / (height_in - OTHER_HEIGHT_IN))
    _violins(right, [row.controller for row in rows], voltages, band_pu)
    figure.suptitle(f"{summary.scenario}, {summary.episodes} test episodes", fontsize=11)
    return figure


def _pareto(ax: Axes, rows: Sequence[Summary], line: float) -> None:
    """``line``: room for a name, as a share of the height."""
    means = [row.means or {} for row in rows]
    x = np.array([m["delay_mean_s"] for m in means])
    y = np.array([m["voltage_deviation_mean_pu"] for m in means])
    front = pareto_front(x, y)
    order = np.flatnonzero(front)[np.argsort(x[front], kind="stable")]
    ax.plot(x[order], y[order], drawstyle="steps-post", color=FRONT_COLOUR, linewidth=1.2, zorder=1)
    room_x = 0.06 * max(float(np.ptp(x)), 0.1)
    room_y = 0.06 * max(float(np.ptp(y)), 1e-4)
    ax.set_xlim(x.min() - room_x, x.max() + room_x)
    ax.set_ylim(y.min() - room_y, y.max() + room_y)
    colours = [REFERENCE_COLOUR if r.controller == REFERENCE else FRONT_COLOUR if f else REST_COLOUR for r, f in
               zip(rows, front, strict=True)]  # fmt: skip
    ax.scatter(x, y, c=colours, s=34, zorder=3, edgecolor="white", linewidth=0.6)
    _names_at_the_side(ax, x, y, [short(row.controller) for row in rows], colours, line)
    ax.set_xlabel("mean delay of work (s)")
    ax.set_ylabel("mean |V - 1| (p.u.)")
    ax.set_title("voltage against delay (blue: Pareto front; lower left is better)", fontsize=9)
    _without_spines(ax)


def _names_at_the_side(
    ax: Axes, x: np.ndarray, y: np.ndarray, names: Sequence[str], colours: Sequence[str], line: float
) -> None:
    """Names in a column to the right, in the order of the points' heights, each with a line to its point."""
    low, high = ax.get_ylim()
    share = (y - low) / (high - low)
    order = np.argsort(share, kind="stable")
    places = _apart(share[order], min(line, 1.0 / max(len(order) - 1, 1)))
    for height, i in zip(places, order.tolist(), strict=True):
        ax.annotate(
            str(names[i]),
            xy=(x[i], y[i]),
            xytext=(1.06, height),
            textcoords="axes fraction",
            fontsize=8,
            color=colours[i],
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colours[i], "linewidth": 0.6, "alpha": 0.55, "relpos": (0.0, 0.5)},
        )


def _apart(wanted: np.ndarray, gap: float) -> np.ndarray:
    """Ascending places in 0 .. 1 near the wanted, at least ``gap`` from one to the next."""
    steps = gap * np.arange(len(wanted))
    room = max(1.0 - gap * (len(wanted) - 1), 0.0)
    # Least squares under the order, by pooling neighbours that would overlap (isotonic regression).
    pools: list[list[float]] = []
    for value in np.clip(wanted, 0.0, 1.0) - steps:
        pools.append([value, 1.0])
        while len(pools) > 1 and pools[-2][0] > pools[-1][0]:
            (a, n), (b, m) = pools.pop(-2), pools.pop(-1)
            pools.append([(a * n + b * m) / (n + m), n + m])
    return np.clip(np.concatenate([np.full(int(n), value) for value, n in pools]), 0.0, room) + steps


def _violins(ax: Axes, names: Sequence[str], voltages: Mapping[str, np.ndarray], band_pu: float) -> None:
    middle = 0.5 * (V_EDGES_PU[1:] + V_EDGES_PU[:-1])
    lows, highs = [1.0 - band_pu], [1.0 + band_pu]
    for row, name in enumerate(names):
        counts = voltages[name]
        colour = REFERENCE_COLOUR if name == REFERENCE else FRONT_COLOUR
        width = 0.42 * counts / counts.max()
        occupied = np.flatnonzero(counts)
        part = slice(occupied[0], occupied[-1] + 1)
        ax.fill_between(middle[part], row - width[part], row + width[part], color=colour, alpha=0.35, linewidth=0)
        lows.append(float(middle[occupied[0]]))
        highs.append(float(middle[occupied[-1]]))
        share = np.cumsum(counts) / counts.sum()
        p1, p25, p50, p75, p99 = (middle[np.searchsorted(share, q)] for q in (0.01, 0.25, 0.5, 0.75, 0.99))
        ax.plot([p1, p99], [row, row], color=colour, linewidth=1.0)
        ax.plot([p25, p75], [row, row], color=colour, linewidth=3.2, solid_capstyle="butt")
        ax.plot(p50, row, marker="|", color="black", markersize=9, markeredgewidth=1.4)
        ax.plot([lows[-1], highs[-1]], [row, row], linestyle="none", marker=".", color=colour, markersize=3)
    for edge in (1.0 - band_pu, 1.0 + band_pu):
        ax.axvline(edge, color="black", linestyle="--", linewidth=0.9)
    ax.axvline(1.0, color="black", linewidth=0.5, alpha=0.5)
    ax.set_xlim(min(lows) - 0.006, max(highs) + 0.006)
    ax.set_yticks(range(len(names)), [short(name) for name in names], fontsize=8)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlabel("voltage of all buses and steps (p.u.)")
    ax.set_title("voltages (tick: median, thick: 25 to 75 %, thin: 1 to 99 %, dots: extremes)", fontsize=9, loc="right")
    _without_spines(ax)


def _without_spines(ax: Axes) -> None:
    ax.grid(alpha=0.25, linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
