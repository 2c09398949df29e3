"""Compare controllers during a recorded sequence of sags: lost load, voltage after it, time until reconnection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dcgrid_env import METRICS, Metric, Recorder, Scenario, make_scenario, sag_times
from dcgrid_env.agents import find_controller
from dcgrid_env.baselines.carried import carried
from dcgrid_env.baselines.hindsight_costs import BEST_KNOWN, published
from dcgrid_env.baselines.recorded_actions import replayed
from dcgrid_env.baselines.rollout import rollout
from dcgrid_env.baselines.scenario_names import one_scenario
from dcgrid_env.baselines.score import SPLIT
from dcgrid_env.core.commands.names import split_names
from dcgrid_env.core.commands.settings import check_folder
from dcgrid_env.core.commands.terminal import plain_console, say, working
from dcgrid_env.core.commands.workers import OverWorkers
from dcgrid_env.core.figure_axes import new_figure
from dcgrid_env.core.files import write_figure, write_text
from dcgrid_env.core.versions import meta
from dcgrid_env.core.work.local_pool import ONE_PROCESS
from dcgrid_env.core.work.unit import Place, Unit
from docs.studies.learning.learning_tables import Table, page, wrapped

LOST_SHARE = Metric("lost_step_pct", "load lost in a step, share of the feeder's load", "%", 0, "lower")
COLUMNS = (
    (METRICS["J"], "mean"), (METRICS["ups_trips"], "mean"), (METRICS["ups_lost_kw"], "mean"),
    (METRICS["ups_lost_step_kw"], "mean"), (LOST_SHARE, "mean"), (METRICS["ups_away_s"], "mean"),
    (METRICS["ups_all_back_s"], "mean"), (METRICS["inverter_trips"], "mean"),
    (METRICS["voltage_after_loss_max_pu"], "mean"), (METRICS["voltage_after_loss_max_pu"], "most"),
    (METRICS["voltage_min_pu"], "least"),
)  # fmt: skip
"""Columns of the table, and what each is over the episodes."""
OVER = {"mean": np.mean, "most": np.max, "least": np.min}


@dataclass(frozen=True)
class Course:
    """One episode, over its steps (T,)."""

    time_s: np.ndarray
    sites_kw: np.ndarray
    """Draw of each site, kW, (T, site)."""
    pv_kw: np.ndarray
    """What all inverters feed in, kW."""
    v_low_pu: np.ndarray
    """Lowest voltage of the feeder, p.u."""
    v_high_pu: np.ndarray
    """Highest."""
    figures: Mapping[str, float]
    """Metrics of the episode."""


@dataclass(frozen=True)
class Driven:
    """All episodes under one controller."""

    name: str
    figures: tuple[float, ...]
    """Those of ``COLUMNS``."""
    course: Course
    """The episode that is drawn."""


@dataclass(frozen=True)
class SagStudy:
    """All that is written and drawn."""

    scenario: Scenario
    episodes: int
    seed: int
    """The episode that is drawn."""
    load_kw: float
    """Load of the feeder by its tables and the sites' ratings, kW."""
    sag_s: np.ndarray
    """When the sags of that episode begin, s."""
    driven: tuple[Driven, ...]


class _Asked(NamedTuple):
    """A controller on a preset's test episodes; without a name the best known, from its bundled actions."""

    scenario: str
    name: str | None
    episodes: int
    seed: int


def sag_study(
    scenario: str,
    names: Sequence[str],
    episodes: int,
    seed: int,
    best: bool = False,
    place: Place = ONE_PROCESS,
) -> SagStudy:
    """Drive the test episodes of a preset with sags under each controller.

    Parameters
    ----------
    scenario, names
        The preset, and controllers by their names.
    episodes
        Seeds 0, 1, ..
    seed
        The episode that is drawn, one of these.
    best
        Whether the bundled best known actions (``python -m docs.studies best-known``) are driven behind the others.
    place
        Where each controller's episodes are run as a unit.

    Raises
    ------
    ValueError
        For an episode to draw that is not driven, or a preset without sags or sites that leave; a LostUnits for
        controllers that cannot drive it.
    """
    test = make_scenario(scenario, split=SPLIT)
    if not 0 <= seed < episodes:
        raise ValueError(f"seed is {seed}; give one of the {episodes} episodes, 0 to {episodes - 1}")
    if not test.sags or getattr(test.datacenters, "ride_through", None) is None:
        raise ValueError(f"scenario is {scenario!r}, which has no sags or no sites that leave; give ride-through")
    asked = [_Asked(scenario, name, episodes, seed) for name in (*names, *([None] if best else []))]
    units = [Unit(one.name or BEST_KNOWN, _drive, one) for one in asked]
    found = {unit.key: driven for unit, driven in place.results(units, carried(place, (), names), how_to_go_on="")}
    driven = tuple(sorted((found[unit.key] for unit in units), key=_cost))
    return SagStudy(test, episodes, seed, _load_kw(test), sag_times(test, seed), driven)


def _drive(asked: _Asked) -> Driven:
    """Run one controller and summarise its episodes."""
    test, seeds = make_scenario(asked.scenario, split=SPLIT), range(asked.episodes)
    if asked.name is None:
        return _driven(BEST_KNOWN, replayed(test, seeds), asked.seed, _load_kw(test))
    recorder = rollout(test, find_controller(asked.name, test), seeds)
    return _driven(asked.name, recorder, asked.seed, _load_kw(test))


def _load_kw(test: Scenario) -> float:
    return float(np.sum(test.feeder.p_load_kw) + test.datacenters.parameters.p_rated_kw.sum())


def _cost(one: Driven) -> float:
    """Return the sort key of a controller: -J, so the highest cost comes first."""
    return -one.figures[0]


def _driven(name: str, recorder: Recorder, seed: int, load_kw: float) -> Driven:
    """Summarise the episodes of one controller."""
    metrics = recorder.metrics()
    for of_episode in metrics:
        of_episode[LOST_SHARE.name] = 100.0 * of_episode["ups_lost_step_kw"] / load_kw
    figures = tuple(float(OVER[how]([one[metric.name] for one in metrics])) for metric, how in COLUMNS)
    return Driven(name, figures, _course(recorder, seed))


def _course(recorder: Recorder, env_index: int) -> Course:
    own, scenario = recorder.series(env_index), recorder.scenario
    n_dc, n_inv = scenario.datacenters.count, scenario.inverters.count
    v = own.v_pu[1:, scenario.feeder.load_slice]
    return Course(
        time_s=scenario.dt_s * np.arange(1, len(v) + 1),
        sites_kw=own.p_kw[:, :n_dc],
        pv_kw=-own.p_kw[:, n_dc : n_dc + n_inv].sum(axis=1),
        v_low_pu=v.min(axis=1),
        v_high_pu=v.max(axis=1),
        figures=own.metrics(),
    )


def table(study: SagStudy) -> Table:
    """The figures of each controller."""
    headings = [metric.heading + (f", {how}" if how != "mean" else "") for metric, how in COLUMNS]
    rows = [
        (one.name, *(metric.text(value) for (metric, _), value in zip(COLUMNS, one.figures, strict=True)))
        for one in study.driven
    ]
    title = f"{study.scenario.name}: {study.episodes} test episodes, means unless stated otherwise"
    return Table(title, ("controller", *headings), tuple(rows))


def markdown(study: SagStudy, made_by: str, image: str) -> str:
    """The page."""
    s, sites_kw = study.scenario, study.scenario.datacenters.parameters.p_rated_kw
    about = (
        f"**Question.** A feeder of {study.load_kw:.0f} kW with {len(sites_kw)} sites behind UPS "
        f"({sites_kw.sum():.0f} kW) and {s.inverters.parameters.s_rated_kva.sum():.0f} kVA of PV experiences six "
        "voltage sags within 82 s. How much load is lost, how high does the voltage rise, and when have all sites "
        "reconnected?"
    )
    method = (
        "The sags repeat those of 10 July 2024 in Virginia (NERC): each lasts 42 to 66 ms with a residual voltage of "
        "0.25 to 0.40 p.u. No controller can prevent a sag. Controllers decide when and how fast the sites reconnect "
        "and what clocks and inverters do in the meantime. [Ride-through](ride-through.md) describes the model and its "
        "trip settings."
    )
    drawn = (
        f"The figure shows test episode {study.seed}; dashed lines mark the sags. Above 1.10 p.u. inverters trip after "
        "2 s and sites at once. Below 0.90 p.u. sites trip after 10 s."
    )
    about_best = (
        "`best known` comes from a search over the actions of each episode with full knowledge of it. It is not an "
        "upper bound, and no controller can reach it from observations alone."
    )
    scale = (
        "On that day 1,500 MW of load left the transmission grid. The sags, the rule of three events in a minute and "
        "the order of events are comparable with this study. The amount is not: a distribution feeder loses hundreds "
        "of kW. The model does not include frequency or the transmission system."
    )
    picture = f"![The recorded sags under each controller]({image})"
    before = (wrapped(about), wrapped(_answer(study)), wrapped(method), picture, wrapped(drawn))
    after = (wrapped(about_best) if any(one.name == BEST_KNOWN for one in study.driven) else "",)
    limits = f"## Limitations\n\n{wrapped(scale)}"
    return page("Six voltage sags in 82 seconds", made_by, *before, table(study).markdown(), *after, limits)


def _answer(study: SagStudy) -> str:
    """Compare the cheapest controller with the most expensive one; empty for a single controller."""
    ranked = [one for one in study.driven if one.name != BEST_KNOWN]
    if len(ranked) < 2:
        return ""
    worst, best = ranked[0], ranked[-1]
    trips, lost_kw = 1, 2
    return (
        f"**Answer.** `{best.name}` costs least. Compared with `{worst.name}`, the mean number of site trips falls "
        f"from {worst.figures[trips]:.1f} to {best.figures[trips]:.1f}, and the lost load from "
        f"{worst.figures[lost_kw]:.0f} to {best.figures[lost_kw]:.0f} kW."
    )


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


@dataclass(frozen=True)
class Sags(OverWorkers):
    """Compare controllers during a recorded sequence of sags.

    Shows which sites disconnect, how high the voltage rises and how long until all have reconnected.
    """

    scenario: str = "ride-through"
    """Name of a preset with sags and sites behind UPS (dcgrid list)."""
    controllers: str = "none,return-by-hand,staggered-return,staggered-return-tuned,ride-through-analytic"
    """Controllers separated by commas, a column of the figure each; the best known result follows if it exists for all
    episodes."""
    beside: str = "droop-tuned,ride-through-ppo,ride-through-affine"
    """Controllers that are only in the table, separated by commas; empty for none."""
    episodes: int = 32
    """Number of test episodes: seeds 0, 1, .."""
    seed: int = 1
    """The episode that is drawn."""
    out: Path = Path("results/sags")
    """Folder for sag-study.md and images/sag-study.png."""

    def run(self) -> None:
        """Drive, draw, write. ValueError for an invalid setting."""
        if self.episodes < 1:
            raise ValueError(f"episodes is {self.episodes}; give at least 1")
        place, name, console = self.place, one_scenario(self.scenario), plain_console()
        check_folder(self.out / "images")
        test = make_scenario(name, split=SPLIT)
        known = published(test)
        every = known is not None and known.is_best_known and not known.missing(range(self.episodes))
        with working(console, f"{self.episodes} test episodes of {name}"):
            beside = split_names(self.beside)
            study = sag_study(name, [*split_names(self.controllers), *beside], self.episodes, self.seed, every, place)
        drawn = replace(study, driven=tuple(one for one in study.driven if one.name not in beside))
        write_figure(self.out / "images" / "sag-study.png", sag_figure(drawn), dpi=110)
        write_text(self.out / "sag-study.md", markdown(study, meta()["command"], "images/sag-study.png"))
        console.print(table(study).rich(console.width))
        say(console, f"wrote {self.out / 'sag-study.md'} and {self.out / 'images' / 'sag-study.png'}")
