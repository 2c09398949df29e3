"""The front of voltage against delay: policies trained under a limit on mean delay, over the droop law's curve."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dcgrid_env.agents.train_command import ALGORITHMS
from dcgrid_env.agents.training.training_runs import command
from dcgrid_env.baselines import Droop
from dcgrid_env.baselines.scenario_names import one_scenario
from dcgrid_env.baselines.score import REFERENCE
from dcgrid_env.baselines.tuning.tuned import tuned_parameters
from dcgrid_env.core.commands.settings import check_folder
from dcgrid_env.core.commands.terminal import plain_console, say, working
from dcgrid_env.core.figure_axes import FRONT_COLOUR, REFERENCE_COLOUR, REST_COLOUR, label_axes, new_figure
from dcgrid_env.core.files import write_figure, write_text
from dcgrid_env.core.versions import meta
from docs.studies.learning.learning_tables import HEADINGS, Table, brief, commands, figures, page, wrapped
from docs.studies.learning.scored import Scored, controller_on_test, on_test, scored
from docs.studies.learning.trainings import Study, do_trainings, folder, positive_numbers, trained

K_P_MW_PER_PU = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 14.0, 20.0)
"""Active gains of the droop law's curve; the paper's Table I has 1, 10 and 20."""
PAPERS_ALPHA_PER_S, BETWEEN_PER_S = 0.3, 0.03
VALIDATION_EPISODES = 100
"""To select a policy on: a mean delay hangs on a few heavy episodes."""
POINTS = ("mpc-one-step",)
"""Controllers shown as single points; they use a model of the whole feeder."""


@dataclass(frozen=True)
class Learned:
    """Policies of one limit, one for each training seed."""

    limit_s: float | None
    """None: waiting is priced as the scenario has it."""
    tested: Scored
    command: str
    """Command of the first seed's training."""

    @property
    def label(self) -> str:
        """What tables call it."""
        return "none, J as it is" if self.limit_s is None else f"{self.limit_s:g} s"


@dataclass(frozen=True)
class Swept:
    """The droop law, its active gain swept, at one share of the backlog asked back for."""

    alpha_per_s: float
    tuned: bool
    """Whether alpha is the tuned one."""
    k_p_mw_per_pu: tuple[float, ...]
    tested: tuple[Scored, ...]


@dataclass(frozen=True)
class Front:
    """All that is drawn."""

    scenario: str
    episodes: int
    learned: tuple[Learned, ...]
    swept: tuple[Swept, ...]
    points: dict[str, Scored]
    """Single controllers by name, the tuned droop first."""


def configs(algorithm: type[Any], scenario: str, limits_s: Sequence[float], chosen: dict[str, Any], seeds: int,
            runs: Path) -> list[Any]:  # fmt: skip
    """A run for each limit, and one without, and each seed; ``chosen`` are further settings of the training."""
    placed = []
    for limit_s in (*limits_s, None):
        label = "no-limit" if limit_s is None else f"delay-{limit_s:g}"
        for seed in range(seeds):
            one = algorithm(
                scenario=scenario, seed=seed, delay_limit_s=limit_s, validation_episodes=VALIDATION_EPISODES, **chosen
            )
            placed.append(_placed(one, runs, label))
    return placed


def _placed(config: Any, runs: Path, label: str) -> Any:
    return dataclasses.replace(config, out=folder(runs, config.scenario, label, config.updates, config.seed))


def front(scenario: str, episodes: int, configs: Sequence[Any]) -> Front:
    """Test the policies of finished runs, the droop laws and the other controllers."""
    by_limit: dict[float | None, list[Any]] = {}
    for config in configs:
        by_limit.setdefault(config.delay_limit_s, []).append(config)
    learned = tuple(
        Learned(limit_s, scored([trained(one)[0] for one in every], scenario, episodes), command(every[0]))
        for limit_s, every in by_limit.items()
    )
    points = {name: controller_on_test(name, scenario, episodes) for name in (REFERENCE, *POINTS)}
    return Front(scenario, episodes, learned, swept(scenario, episodes), points)


def swept(scenario: str, episodes: int) -> tuple[Swept, ...]:
    """The droop law's curves: all gains as tuned but k_p, and then alpha too, which decides what k_p costs in delay."""
    tuned = tuned_parameters("droop", on_test(scenario)).parameters
    curves: list[Swept] = []
    for alpha in dict.fromkeys((float(tuned["alpha_per_s"]), BETWEEN_PER_S, PAPERS_ALPHA_PER_S)):
        gains: list[dict[str, Any]] = [tuned | {"k_p_mw_per_pu": k_p, "alpha_per_s": alpha} for k_p in K_P_MW_PER_PU]
        tested = tuple(scored([Droop(**gain)], scenario, episodes) for gain in gains)
        curves.append(Swept(alpha, alpha == tuned["alpha_per_s"], K_P_MW_PER_PU, tested))
    return tuple(curves)


def learned_table(front: Front) -> Table:
    """The learned front."""
    n = len(front.learned[0].tested.each) if front.learned else 0
    rows = [(one.label, *figures(one.tested.mean.means), _delays(one.tested)) for one in front.learned]
    rows += [(name, *figures(tested.mean.means), "") for name, tested in front.points.items()]
    title = (
        f"{front.scenario}: {front.episodes} test episodes, means over episodes and {n} training seed{'s' * (n > 1)}"
    )
    return Table(title, ("limit on mean delay", *HEADINGS, "mean delay of each seed, s"), tuple(rows))


def _delays(tested: Scored) -> str:
    return ", ".join(f"{one.means['delay_mean_s']:.2f}" for one in tested.each)


def droop_table(front: Front) -> Table:
    """The droop law's curves."""
    rows = [
        (f"{curve.alpha_per_s:g}{' (tuned)' if curve.tuned else ''}", f"{k_p:g}", *figures(tested.mean.means))
        for curve in front.swept
        for k_p, tested in zip(curve.k_p_mw_per_pu, curve.tested, strict=True)
    ]
    return Table("The droop law, k_p swept", ("alpha, 1/s", "k_p, MW/p.u.", *HEADINGS), tuple(rows))


def markdown(front: Front, made_by: str, image: str) -> str:
    """The page."""
    about = (
        "Each policy is trained for the lowest cost without the delay terms, under a limit on the mean delay. A "
        "multiplier on the delay rises while the limit is exceeded on the training split. The policy kept is the best "
        "on the validation split. The table shows the test split, so the mean delay can differ from the limit. The "
        "policy without a limit pays for waiting as J does."
    )
    under = (
        "The second table is the droop law at several active gains k_p and three shares alpha of the backlog that it "
        f"asks back per second: the tuned one, {BETWEEN_PER_S:g}, and the paper's {PAPERS_ALPHA_PER_S:g}. One-step MPC "
        "knows the whole feeder; policies and droop observe their own bus."
    )
    each = commands("The training of the first seed of each row:", ((one.label, one.command) for one in front.learned))
    parts = (wrapped(about), wrapped(under), f"![{front.scenario}: voltage against delay]({image})")
    return page("Voltage against delay", made_by, *parts, learned_table(front).markdown(), each,
                droop_table(front).markdown())  # fmt: skip


PANELS = (
    ("voltage_deviation_mean_pu", 1e3, "mean |V - 1| (0.001 p.u.)"),
    ("outside_bus_seconds_pct", 1.0, "bus-seconds outside the band (%)"),
    ("J_but_delay", 1.0, "J without delay"),
)
"""Metric, factor and name of each panel of the front; the policies are trained for the last metric."""
LINEAR_S = 0.1
"""Delay up to which the axis is linear, so that none has its place, s."""
DASHES = ("-", "--", ":")
MARKS = {REFERENCE: ("D", REFERENCE_COLOUR), "mpc-one-step": ("s", REST_COLOUR)}


def pareto_figure(front: Front) -> Figure:
    """The learned front over the droop law's curves, in mean deviation, time outside the band, and cost."""
    figure = new_figure(14.4, 5.0)
    axes = figure.subplots(1, len(PANELS))
    for ax, (metric, factor, name) in zip(axes, PANELS, strict=True):
        _front(ax, front, metric, factor)
        label_axes(ax, "mean delay of work (s)", name)
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
                    label="learned, delay priced as in J")  # fmt: skip
            _seeds(ax, one, metric, factor)


def _seeds(ax: Axes, one: Learned, metric: str, factor: float) -> None:
    """Each training seed as a dot where there are several."""
    if len(one.tested.each) > 1:
        means = [seed.means for seed in one.tested.each]
        x, y = ([m[key] for m in means] for key in ("delay_mean_s", metric))
        ax.plot(x, factor * np.array(y), linestyle="none", marker=".", markersize=4, color=FRONT_COLOUR, alpha=0.5)


@dataclass(frozen=True)
class Pareto(Study):
    """Draw voltage against delay of policies with delay limits.

    Trains policies under limits on the mean delay and draws them over the droop law's own curve.

    Trainings are kept in RUNS: an interrupted command goes on where it was, and what is done is not done again.
    """

    scenario: str = "ieee33-weak"
    """Name of a scenario (dcgrid list)."""
    delays: str = "0.25,0.5,1,2,4,8"
    """Limits on mean delay, s, separated by commas."""
    runs: Path = Path("results/pareto")
    """Folder of the training runs."""
    out: Path = Path("results/pareto")
    """Folder for pareto.md and images/pareto.png."""

    def run(self) -> None:
        """Train, test, draw, write. ValueError for an invalid setting, before anything is trained."""
        scenario = one_scenario(self.scenario)
        limits_s = positive_numbers("delays", self.delays)
        chosen = self.settings()
        runs = configs(ALGORITHMS["analytic"].configuration(), scenario, limits_s, chosen, self.seeds, self.runs)
        check_folder(self.out / "images")
        console = plain_console()
        failures = do_trainings(runs, self.place, console)
        if failures:
            raise ValueError(f"{len(failures)} of {len(runs)} trainings failed: {next(iter(failures.values()))}")
        with working(console, f"{self.episodes} test episodes of {scenario}"):
            found = front(scenario, self.episodes, runs)
        write_figure(self.out / "images" / "pareto.png", pareto_figure(found), dpi=130)
        write_text(self.out / "pareto.md", markdown(found, meta()["command"], "images/pareto.png"))
        console.print(brief(learned_table(found), "J", "J without delay", "mean delay, s").rich(console.width))
        say(console, f"wrote {self.out / 'pareto.md'} and {self.out / 'images' / 'pareto.png'}")
